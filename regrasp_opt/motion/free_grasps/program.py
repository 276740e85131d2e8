"""Poses and grasps of one chain as one nonlinear program; see `regrasp_opt.motion.free_grasps.search`."""

from __future__ import annotations

import itertools
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray
from regrasp_opt.energy.export import grasp_function
from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.motion.refinement.program import planar
from regrasp_opt.solvers.nonlinear_program import NonlinearProgram
from regrasp_opt.solvers.options import ProgramOptions

STEP = np.array([0.02, 0.02, 0.02, 0.4, 0.4, 0.4])
"""Largest step of a grasp along and about each axis of its tool frame [m, rad]."""

STEP_WEIGHT = 0.1
"""Weight of a full step, squared, beside energies."""

SLIDE = 0.02
"""Standard deviation of random slides along the surface [m]."""

OPTIONS = ProgramOptions(hessian="limited-memory", max_iterations=20, tolerance=1e-3, ipopt=(("mu_init", 1e-3),))


class ChainSolve(NamedTuple):
    """Planar parameters (N, 3), steps of the grasps (N+1, 6) in units of `STEP`, and the objective."""

    xi: FloatArray
    steps: FloatArray
    cost: float


class FreeGraspProgram:
    """The program of chains with `size` intermediate poses, for grasps of one `kind`.

    A parallel grasp does not move along its closing direction, nor a suction grasp along its approach: the object's
    surface says where they stand there.
    """

    def __init__(self, model: EnergyModel, size: int, kind: Literal["parallel", "suction"]) -> None:
        self.size = size
        self._fixed = 1 if kind == "parallel" else 2
        energy = grasp_function(model)
        nlp = NonlinearProgram()
        xi, d = nlp.variable("xi", (size, 3)), nlp.variable("steps", (size + 1, 6))
        given = ca.horzsplit(nlp.parameter("transforms", (4, 4 * (3 * size + 3))), 4)
        width = nlp.parameter("width", size + 1)
        edges = itertools.pairwise([0, size, 2 * size, 2 * size + 2, None])
        surfaces, bases, ends, grasps = (given[slice(*edge)] for edge in edges)
        poses = [ends[0], *[surfaces[i] @ planar(xi[i, :]) @ T for i, T in enumerate(bases)], ends[1]]
        nlp.add_cost(STEP_WEIGHT * ca.sumsqr(d))
        for i, T in enumerate(grasps):
            g = T @ _displacement(d[i, :].T)
            nlp.add_cost(energy(poses[i], g, width[i]) + energy(poses[i + 1], g, width[i]))
        self._solver = nlp.solver(OPTIONS)

    def solve(
        self, placements: PlanarPoses, ends: FloatArray, T_object_tcp: FloatArray, width: FloatArray, start: ChainSolve
    ) -> ChainSolve:
        """Solve from `start`.

        `placements` are those of the N intermediate poses, `ends` (2, 4, 4) start and goal, `T_object_tcp` (N+1, 4, 4)
        and `width` (N+1,) the grasps that the steps begin at.
        """
        transforms = np.concatenate([placements.surfaces, placements.bases, ends, T_object_tcp])
        p = np.concatenate([transforms.transpose(0, 2, 1).ravel(), width])
        step = np.where(np.arange(6) == self._fixed, 0.0, 1.0)
        low, high = (
            np.concatenate([side.ravel(), np.tile(sign * step, self.size + 1)])
            for side, sign in ((placements.low, -1.0), (placements.high, 1.0))
        )
        x0 = np.concatenate([start.xi.ravel(), start.steps.ravel()]).clip(low, high)
        solution = self._solver.solve(x0, p=p, lbx=low, ubx=high)
        x = solution.x
        if not (np.isfinite(x).all() and np.isfinite(solution.f)):
            return start
        return ChainSolve(x[: 3 * self.size].reshape(-1, 3), x[3 * self.size :].reshape(-1, 6), solution.f)


def _displacement(d: Any) -> Any:
    """Return the transform (4, 4) of one step (6, 1): a translation, and a turn by the quaternion (1, r / 2)."""
    s = d * ca.DM(STEP)
    q = ca.vertcat(1, s[3:] / 2)
    w, x, y, z = ca.vertsplit(q / ca.norm_2(q))
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), s[0]),
        ca.horzcat(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), s[1]),
        ca.horzcat(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), s[2]),
        ca.DM([[0.0, 0.0, 0.0, 1.0]]),
    )


def displaced(T: FloatArray, d: FloatArray) -> FloatArray:
    """Return the tool pose (4, 4) that one step (6,) leads to from `T`."""
    moved: FloatArray = T @ np.array(_displacement(ca.DM(d)))
    return moved


def random_move(kind: str, rng: np.random.Generator) -> FloatArray:
    """Return a transform (4, 4) from a tool pose to one that keeps its contacts or slides them by a few centimetres.

    A parallel grasp turns by any angle about its closing direction and perhaps half a turn about its approach, a
    suction grasp by any angle about its approach.
    """
    D = np.eye(4)
    angle, slide = rng.uniform(-np.pi, np.pi), SLIDE * rng.random() * rng.normal(size=2)
    if kind == "parallel":
        flip = np.diag([-1.0, -1.0, 1.0]) if rng.random() < 0.5 else np.eye(3)
        D[:3, :3] = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix() @ flip
        D[[0, 2], 3] = slide
    else:
        D[:3, :3] = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        D[:2, 3] = slide
    return D
