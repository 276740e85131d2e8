"""All-branch inverse kinematics of six-joint arms with a known decomposition, through EAIK.

EAIK (Ostermeier, Kuelz, Althoff, 2024) solves the arm as a sequence of geometric subproblems. It knows
neither joint limits nor rounded poses, so targets are made exact rotations first and every branch is proven
afterwards.
"""

from __future__ import annotations

import numpy as np
from eaik.IK_HP import HPRobot

from regrasp_opt.conventions import FloatArray
from regrasp_opt.robots.ik import IkSolutions, nearest_rotations, prove
from regrasp_opt.robots.kinematics import SerialChain


class AnalyticIk:
    """Inverse kinematics of a chain of six turning joints; see `analytic_ik`, which makes one.

    Parameters
    ----------
    chain : SerialChain
        The arm.
    lower, upper : (6,) arrays
        Joint limits [rad].
    solver : HPRobot
        The same arm in EAIK's terms, with no rotation of the tip at zero.
    """

    def __init__(self, chain: SerialChain, lower: FloatArray, upper: FloatArray, solver: HPRobot) -> None:
        self._chain, self._lower, self._upper, self._solver = chain, lower, upper, solver
        self._R_tip_base_at_zero = chain.forward(np.zeros(6))[:3, :3].T

    @property
    def family(self) -> str:
        """EAIK's name of the decomposition, for example ``"6R-THREE_INNER_PARALLEL"``."""
        return str(self._solver.getKinematicFamily())

    def solve(self, T_base_tip: FloatArray) -> IkSolutions:
        """Return every branch within the joint limits for poses (B, 4, 4), each one verified."""
        T = nearest_rotations(T_base_tip)
        targets = T.copy()
        targets[:, :3, :3] = T[:, :3, :3] @ self._R_tip_base_at_zero
        raw = [solution.Q for solution in map(self._solver.IK, targets)]
        counts = np.array([len(q) for q in raw], dtype=np.int64)
        if not counts.sum():
            return IkSolutions(np.zeros((0, 6)), np.zeros(0, dtype=np.int64))
        q = np.concatenate([branch for branch in raw if len(branch)])
        return prove(self._chain, T, IkSolutions(q, np.repeat(np.arange(len(T)), counts)), self._lower, self._upper)


def analytic_ik(chain: SerialChain, lower: FloatArray, upper: FloatArray) -> AnalyticIk | None:
    """Return the analytic inverse kinematics of `chain`, or None where none is known for it."""
    if chain.dof != 6 or chain.prismatic.any():
        return None
    frames = chain.link_transforms(np.zeros(6))
    axes = (frames[:, :3, :3] @ chain.axes[..., None])[..., 0]
    points = np.concatenate([np.zeros((1, 3)), frames[:, :3, 3], chain.forward(np.zeros(6))[None, :3, 3]])
    solver = HPRobot(axes, np.diff(points, axis=0))
    return AnalyticIk(chain, lower, upper, solver) if solver.hasKnownDecomposition() else None
