"""Seeded start-goal pairs, sorted by the fewest regrasps that the oracle needs, and frozen by hash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from regrasp_opt.benchmarks.harness.oracle import Oracle
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, invert, planar_transform
from regrasp_opt.errors import PoseError
from regrasp_opt.feasibility.dataset import random_poses
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.ends import checked_end
from regrasp_opt.planning.tasks import random_task

POOL = 400
"""Random poses among which pairs are chosen."""


@dataclass(frozen=True, eq=False)
class Instance:
    """A planning task: `start` and `goal` (4, 4) T_world_object.

    `minimum` is the fewest regrasps that the oracle needs, None if its grid holds no plan.
    """

    name: str
    start: FloatArray
    goal: FloatArray
    minimum: int | None

    @property
    def ends(self) -> FloatArray:
        """Start and goal (2, 4, 4)."""
        return np.stack([self.start, self.goal])

    @property
    def tier(self) -> str:
        """Name of the difficulty: 0, 1, 2, 3+ or unsolvable (at the oracle's resolution)."""
        if self.minimum is None:
            return "unsolvable"
        return str(self.minimum) if self.minimum < 3 else "3+"


TIERS = ("1", "2", "3+", "unsolvable")
"""The difficulties of tasks that need a regrasp."""


@dataclass(frozen=True, eq=False)
class PosePool:
    """Random resting poses `T` (P, 4, 4) in the workspace with the exact feasibility (P, G) of all grasps."""

    T: FloatArray
    feasible: BoolArray

    @staticmethod
    def draw(problem: RegraspProblem, seed: int, count: int = POOL) -> PosePool:
        """Draw `count` poses and keep those at which the object can rest and some grasp is feasible."""
        rng = np.random.default_rng([seed, 2])
        numbers, xi = random_poses(problem.placement_poses, problem.workcell.bounds.array, count, rng)
        T = planar_transform(xi) @ problem.placement_poses[numbers]
        kept = np.array([_can_rest(problem, pose) for pose in T])
        pool = PosePool(T[kept], np.array([problem.checker.feasible(pose) for pose in T[kept]]))
        return pool.with_grasps(np.arange(len(problem.grasps)))

    def with_grasps(self, ids: IntArray) -> PosePool:
        """Return the poses at which one of the grasps `ids` is feasible, with these grasps alone."""
        feasible = self.feasible.reshape(len(self.T), -1)[:, ids]
        some = feasible.any(axis=1)
        return PosePool(self.T[some], feasible[some])


def _can_rest(problem: RegraspProblem, T: FloatArray) -> bool:
    try:
        checked_end(T, "start", problem)
    except PoseError:
        return False
    return True


def choose_instances(
    pool: PosePool, oracle: Oracle, wanted: dict[str, int], rng: np.random.Generator, prefix: str
) -> list[Instance]:
    """Return random pairs of pool poses, up to ``wanted[tier]`` of each tier; their names begin with `prefix`.

    The tier ``any`` draws from all pairs that need a regrasp, ``0`` from those that do not.
    """
    table = oracle.minimum_table(pool.feasible)
    off_diagonal = ~np.eye(len(table), dtype=bool)
    masks = {str(count): table == count for count in range(3)} | {"any": table >= 1, "unsolvable": np.isinf(table)}
    masks["3+"] = (table >= 3) & np.isfinite(table)
    chosen: list[Instance] = []
    for tier, count in wanted.items():
        pairs = np.argwhere(masks[tier] & off_diagonal)
        for i, j in pairs[rng.permutation(len(pairs))[:count]]:
            minimum = int(table[i, j]) if np.isfinite(table[i, j]) else None
            chosen.append(Instance(f"{prefix}/{tier}/{len(chosen)}", pool.T[i], pool.T[j], minimum))
    return chosen


def random_instances(problem: RegraspProblem, rng: np.random.Generator, count: int, prefix: str) -> list[Instance]:
    """Return `count` random pairs that need a regrasp; the fewest that each needs is not known."""
    tasks = [random_task(problem, rng, needs_regrasp=True) for _ in range(count)]
    return [Instance(f"{prefix}/{k}", task.start, task.goal, None) for k, task in enumerate(tasks)]


def instances_hash(instances: Sequence[Instance]) -> str:
    """Return the hash that freezes `instances`: their names, poses and oracle minima."""
    return content_hash("instances-1", *[[i.name, i.start, i.goal, i.minimum] for i in instances])[:16]


def planar_parameters(T: FloatArray, placements: FloatArray) -> tuple[int, FloatArray]:
    """Return the placement number and planar parameters (3,) [m, m, rad] of a resting pose `T` (4, 4) (Eq. 6).

    The placement is the one of `placements` (S, 4, 4) from which `T` differs least by more than a planar motion.
    """
    motion = T @ invert(placements)
    tilt = 1.0 - motion[:, 2, 2] + np.abs(motion[:, 2, 3])
    number = int(tilt.argmin())
    planar = motion[number]
    return number, np.array([planar[0, 3], planar[1, 3], np.arctan2(planar[1, 0], planar[0, 0])])
