"""Exact ground truth on a grid: which grasps are feasible at every pose, and the fewest regrasps between two poses.

A regrasp changes the grasp at one pose, so two grasps are neighbours if some grid pose admits both, and the least
number of intermediate poses between a start and a goal is the shortest path from a grasp that is feasible at the start
to one that is feasible at the goal. That graph has one node for each grasp, however fine the grid is.

The grid is checked in blocks, each stored as soon as it is done, under a hash of everything that it depends on.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import joblib
import numpy as np
from scipy.sparse.csgraph import shortest_path

from regrasp_opt.benchmarks.harness.runner import resumed
from regrasp_opt.benchmarks.harness.subjects import problem_key, resident
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, planar_transform
from regrasp_opt.errors import OptionError
from regrasp_opt.files import atomic_path, content_hash, data_home
from regrasp_opt.planning import RegraspProblem

BLOCK = 500
"""Poses that are checked and stored together."""

Told = Callable[[int, int], None]


@dataclass(frozen=True)
class Resolution:
    """How fine a grid is: ``spacing`` along x and y [m] and ``yaws`` in a turn."""

    spacing: float
    yaws: int

    def __post_init__(self) -> None:
        if not self.spacing > 0 or self.yaws < 1:
            raise OptionError(f"a grid cannot have spacing {self.spacing} and {self.yaws} yaws; give positive numbers")

    def __str__(self) -> str:
        return f"{self.spacing:g} m, {360 / self.yaws:g} degrees"


PAPER_GRID = Resolution(0.01, 6)
"""The grid of the paper's discrete baseline."""


@dataclass(frozen=True, eq=False)
class Oracle:
    """Exact feasibility `feasible` (L, G) of G grasps on L grid poses.

    `placements` (L,) and `xi` (L, 3) are stable placement and planar parameters of each pose [m, m, rad], `seconds` is
    the processor time that the checks took, whenever they were made.
    """

    placements: IntArray
    xi: FloatArray
    feasible: BoolArray
    seconds: float

    def with_grasps(self, ids: IntArray) -> Oracle:
        """Return the oracle of the grasps `ids` alone."""
        return replace(self, feasible=self.feasible[:, ids])

    @cached_property
    def changes(self) -> FloatArray:
        """The fewest regrasps (G, G) that lead from one grasp to another; infinite where none do."""
        reached = self.feasible[self.feasible.any(axis=1)].astype(np.float32)
        neighbours = (reached.T @ reached) > 0
        return np.asarray(shortest_path(neighbours.astype(np.float64), directed=False, unweighted=True))

    def minimum_table(self, feasible: BoolArray) -> FloatArray:
        """Return the fewest regrasps (P, P) between all pairs of poses with `feasible` (P, G) grasps, or infinity.

        Infinity means that the grid holds no plan.
        """
        rows = feasible.astype(np.float32)
        table = np.full((len(rows), len(rows)), np.inf)
        finite = self.changes[np.isfinite(self.changes)]
        for steps in range(int(finite.max(initial=0.0)), -1, -1):
            within = (self.changes <= steps).astype(np.float32)
            table[(rows @ within @ rows.T) > 0] = steps
        return table

    def one_step(self, start: BoolArray, goal: BoolArray) -> BoolArray:
        """Return the grid poses (L,) that share a grasp with both ends."""
        return np.asarray((self.feasible & start).any(axis=1) & (self.feasible & goal).any(axis=1))


def grid_poses(num_placements: int, bounds: FloatArray, resolution: Resolution) -> tuple[IntArray, FloatArray]:
    """Return placement numbers (L,) and planar parameters (L, 3) of the grid over `bounds` (2, 2), ends included."""
    axes = []
    for low, high in bounds.T:
        count = int((high - low) / resolution.spacing + 1e-9)
        axes.append((low + high) / 2 + resolution.spacing * (np.arange(count + 1) - count / 2))
    yaw = np.arange(resolution.yaws) * (2 * np.pi / resolution.yaws)
    grid = np.meshgrid(np.arange(num_placements), *axes, yaw, indexing="ij")
    return grid[0].ravel(), np.stack([g.ravel() for g in grid[1:]], axis=1)


def build_oracle(
    problem: RegraspProblem, resolution: Resolution, *, jobs: int = -1, progress: Told | None = None
) -> Oracle:
    """Check every grasp of `problem` on the grid, or read what was checked before; see `check_poses`."""
    numbers, xi = grid_poses(len(problem.placements), problem.workcell.bounds.array, resolution)
    return check_poses(problem, numbers, xi, jobs=jobs, progress=progress)


def check_poses(
    problem: RegraspProblem, numbers: IntArray, xi: FloatArray, *, jobs: int = -1, progress: Told | None = None
) -> Oracle:
    """Check every grasp of `problem` at placements `numbers` (L,) and `xi` (L, 3), or read what was checked before.

    Blocks are kept in the data folder. One that cannot be read is reported and made again. There are `jobs` workers, as
    joblib counts them; `progress` is called with (blocks done, blocks in all).
    """
    key = content_hash("oracle-2", problem_key(problem), xi, numbers)[:32]
    folder = data_home() / "oracle" / key
    bare = replace(problem)  # without the heavy parts that may be attached
    starts = range(0, len(numbers), BLOCK)
    parts = {folder / f"{k:07d}.npz": (numbers[k : k + BLOCK], xi[k : k + BLOCK]) for k in starts}
    found = resumed(
        parts,
        lambda path: _read(path, (len(parts[path][0]), len(problem.grasps))),
        lambda path: joblib.delayed(_check_block)(bare, path, *parts[path]),
        _write,
        jobs,
        progress,
    ).values()
    feasible, seconds = zip(*found, strict=True)
    return Oracle(numbers, xi, np.concatenate(feasible), sum(seconds))


Block = tuple[BoolArray, float]
"""Feasibility (L, G) and the seconds that the checks took."""


def _check_block(problem: RegraspProblem, path: Path, placements: IntArray, xi: FloatArray) -> tuple[Path, Block]:
    problem = resident(problem)
    began = time.process_time()
    poses = planar_transform(xi) @ problem.placement_poses[placements]
    open_ = ~problem.table_rule(placements, xi)
    feasible = np.zeros_like(open_)
    for row, T, ids in zip(feasible, poses, map(np.flatnonzero, open_), strict=True):
        row[ids] = problem.checker.feasible(T, ids)
    return path, (feasible, time.process_time() - began)


def _write(block: Block, path: Path) -> None:
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, packed=np.packbits(block[0], axis=1), seconds=block[1])


def _read(path: Path, shape: tuple[int, int]) -> Block:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        packed, seconds = stored["packed"], float(stored["seconds"])
    if packed.dtype != np.uint8 or packed.shape != (shape[0], -(-shape[1] // 8)):
        raise ValueError(f"not the feasibility of {shape} poses and grasps")
    return np.unpackbits(packed, axis=1, count=shape[1]).astype(bool), seconds
