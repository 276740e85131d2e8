"""Random tool poses with their exact feasibility, without any object: what the energy of an arm is trained on.

A third are uniform over the half ball that the tool may reach above the lowest support, in any rotation. The others are
feasible ones of these, moved and turned a little: most of them lie where feasibility changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import joblib
import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.errors import ModelError
from regrasp_opt.feasibility.checker import FeasibilityChecker
from regrasp_opt.feasibility.diagnosis import diagnose, summary
from regrasp_opt.grasps import GraspSet
from regrasp_opt.scene import Workcell
from regrasp_opt.workers import workers

WIDTHS = 16
"""Jaw widths among which poses are spread, from closed to wide open."""
BLOCK = 12_000
"""Poses that are drawn and labelled together, by one seed."""
MOVED, TURNED = 0.06, 0.35
"""Standard deviation, about each axis, of the moves [m] and turns [rad] that lead away from feasible poses."""
_TOLD = 200
"""Poses that say why none is feasible."""


@dataclass(frozen=True)
class LabelledToolPoses:
    """M tool poses: ``T`` (M, 4, 4) T_world_tcp, ``width`` (M,) of the jaw [m], ``feasible`` (M,)."""

    T: FloatArray
    width: FloatArray
    feasible: BoolArray

    def __len__(self) -> int:
        return len(self.feasible)


def label_tool_poses(
    workcell: Workcell,
    count: int,
    *,
    seed: int = 0,
    jobs: int = -1,
    progress: Callable[[int, int], None] | None = None,
) -> LabelledToolPoses:
    """Draw and label at least `count` tool poses of the arm in `workcell`, in whole blocks.

    Parameters
    ----------
    jobs : int
        Worker processes, as joblib counts them; the poses do not depend on it.
    progress : callable, optional
        Called with (poses labelled, poses wanted).

    Raises
    ------
    ModelError
        If no pose in the first block is feasible; says why.
    """
    blocks = [_block(workcell, seed, 0)]
    if not blocks[0].feasible.any():
        raise ModelError(_nothing_feasible(workcell, blocks[0]))
    with workers(jobs, "generator") as parallel:
        for block in parallel(
            joblib.delayed(_block)(workcell, seed, number) for number in range(1, -(-count // BLOCK))
        ):
            blocks.append(block)
            if progress is not None:
                progress(min(count, BLOCK * len(blocks)), count)
    return LabelledToolPoses(
        *(np.concatenate([getattr(b, name) for b in blocks]) for name in ("T", "width", "feasible"))
    )


def _block(workcell: Workcell, seed: int, number: int) -> LabelledToolPoses:
    rng = np.random.default_rng([seed, number])
    jaw = _jaw(workcell)
    checker = FeasibilityChecker(None, workcell, jaw)
    T, ids = _uniform(workcell, BLOCK // 3, rng), rng.integers(len(jaw), size=BLOCK // 3)
    feasible = checker.feasible_pairs(T, ids)
    if not feasible.any():
        return LabelledToolPoses(T, jaw.width[ids], feasible)
    chosen = rng.choice(np.flatnonzero(feasible), BLOCK - len(T))
    near = T[chosen].copy()
    near[:, :3, 3] += rng.normal(scale=MOVED, size=(len(near), 3))
    turns = Rotation.from_rotvec(rng.normal(scale=TURNED, size=(len(near), 3))).as_matrix()
    near[:, :3, :3] = turns @ near[:, :3, :3]
    T, ids = np.concatenate([T, near]), np.concatenate([ids, ids[chosen]])
    feasible = np.concatenate([feasible, checker.feasible_pairs(near, ids[-len(near) :])])
    return LabelledToolPoses(T, jaw.width[ids], feasible)


def _jaw(workcell: Workcell) -> GraspSet:
    """Return a grasp of nothing for each jaw width, at the tool itself."""
    effector = workcell.arm.end_effector
    width = np.linspace(0.0, effector.max_opening, WIDTHS) if effector.kind == "parallel" else np.zeros(1)
    return GraspSet(np.tile(np.eye(4), (len(width), 1, 1)), width, effector.kind)


def _uniform(workcell: Workcell, count: int, rng: np.random.Generator) -> FloatArray:
    """Return tool poses (count, 4, 4), uniform in position and rotation, within reach and above the lowest support."""
    arm = workcell.arm
    reach, base = arm.robot.max_reach + arm.end_effector.tcp_offset, arm.T_world_base[:3, 3]
    lowest = min(support.height for support in workcell.supports)
    bottom = max(-reach, lowest - base[2])
    if bottom > 0.99 * reach:
        raise ModelError(
            f"'{arm.robot.name}' reaches {reach:.2f} m and stands {lowest - base[2]:.2f} m below the lowest support of "
            f"'{workcell.name}', so its energy cannot be trained; check 'robot.position' and the table's height"
        )
    position = np.zeros((0, 3))
    while len(position) < count:
        drawn = rng.uniform([-reach, -reach, bottom], reach, (4 * count, 3))
        position = np.concatenate([position, base + drawn[np.linalg.norm(drawn, axis=1) < reach]])
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    T[:, :3, 3] = position[:count]
    return T


def _nothing_feasible(workcell: Workcell, block: LabelledToolPoses) -> str:
    checker = FeasibilityChecker(None, workcell, _jaw(workcell))
    failures = [failure for T in block.T[:_TOLD] for failure in diagnose(checker, T, np.zeros(1, dtype=np.int64))]
    arm = workcell.arm
    return (
        f"'{arm.robot.name}' with '{arm.end_effector.name}' can be nowhere in workcell '{workcell.name}', so its "
        f"energy cannot be trained; of {len(failures)} tool poses {summary(failures)}"
    )
