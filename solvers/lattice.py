"""A lattice of poses with all their energies: chains of lattice poses as start points, or as plans of their own.

With ``P = exp(-E / alpha)`` (poses x grasps) the pair score is an inner product,
``Q_pair(a, b) = -alpha log(P_a . P_b)`` (Eq. 4), so every one-step bridge costs two matrix-vector products and longer
chains are dynamic programming over blocks of ``P P^T``. Memory: L x G float32 for the lattice, and a few blocks of
`MIDDLE` x `MIDDLE` for chains.

A pair with ``m = P_a . P_b`` expected shared grasps has at least one with probability about ``1 - exp(-m)``; chains are
ranked by the negative log of that, which does not let an abundant pair make up for an empty one.
"""

from __future__ import annotations

import contextlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp_opt.connectivity import SequenceObjective, TableRule, block, sequence_cost
from regrasp_opt.conventions import FloatArray, IntArray, planar_transform
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.files import UNREADABLE_ARRAYS, atomic_path, content_hash
from regrasp_opt.solvers.base import Candidates, Refinement

SPACING = 0.06
"""Distance of neighbouring lattice poses along x and y [m]."""
YAWS = 12
"""Number of lattice yaws in a turn."""
MIDDLE = 1500
"""Poses that a layer of a chain keeps."""
RANKED = 5_000
"""Chains among which the start points are chosen."""
LEAST_CHANCE = 1e-5
"""Probability that a pair shares a grasp, by the energies, below which its chain is not worth refining or verifying.

Of lattice chains that hold, the least had 1e-3; where a number of regrasps cannot work, all have a pair at about 1e-9.
"""
_WORKERS = 2


@dataclass(frozen=True, eq=False)
class PoseLattice:
    """L poses: ``placements`` (L,), ``xi`` (L, 3) and their energies (L, G) in single precision."""

    placements: IntArray
    xi: FloatArray
    energies: NDArray[np.float32]

    @lru_cache(maxsize=2)  # noqa: B019 (a lattice lives as long as its problem)
    def likelihoods(self, alpha: float) -> NDArray[np.float32]:
        """Return ``P = exp(-E / alpha)`` (L, G)."""
        return np.exp(-self.energies / np.float32(alpha))

    @cached_property
    def cells(self) -> IntArray:
        """The coarse cell (L,) of each pose: its placement, a square of three spacings and a quarter turn."""
        x, y = (np.floor(self.xi[:, k] / (3 * SPACING)).astype(np.int64) for k in (0, 1))
        quarter = np.floor(self.xi[:, 2] / (np.pi / 2)).astype(np.int64)
        return np.unique(np.column_stack([self.placements, x, y, quarter]), axis=0, return_inverse=True)[1]

    @staticmethod
    def build(
        energy: GraspEnergy,
        placements: FloatArray,
        bounds: FloatArray,
        cache: Path | None = None,
        table_rule: TableRule | None = None,
    ) -> PoseLattice:
        """Evaluate `energy` on the lattice over `bounds` (2, 2) and `placements` (S, 4, 4).

        Parameters
        ----------
        cache : Path, optional
            Folder in which the energies are kept, under a hash of all they depend on. A file that cannot be read is
            made again.
        table_rule : TableRule, optional
            Grasps that it rules out are blocked.
        """
        numbers, xi = lattice_poses(len(placements), bounds)
        energies = _learned(energy, placements, numbers, xi, cache)
        return PoseLattice(numbers, xi, energies if table_rule is None else block(energies, table_rule(numbers, xi)))


def _learned(
    energy: GraspEnergy, placements: FloatArray, numbers: IntArray, xi: FloatArray, cache: Path | None
) -> NDArray[np.float32]:
    """Return the learned energies (L, G) of the lattice poses, from the cache if they are there."""
    path = None
    if cache is not None:
        path = cache / f"{content_hash(energy.fingerprint(), placements, xi)[:32]}.npy"
        stored = _read(path, (len(xi), len(energy)))
        if stored is not None:
            return stored
    T = planar_transform(xi) @ placements[numbers]
    with ThreadPoolExecutor(_WORKERS) as pool:
        blocks = list(pool.map(lambda part: energy(part, np.float32), np.array_split(T, 8 * _WORKERS)))
    energies = np.concatenate(blocks)
    if path is not None:
        with contextlib.suppress(OSError), atomic_path(path) as temporary, temporary.open("wb") as file:
            np.save(file, energies, allow_pickle=False)  # only a cache: a folder that cannot be written is not an error
    return energies


def lattice_poses(num_placements: int, bounds: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return placement numbers (L,) and planar parameters (L, 3) of a regular lattice over `bounds` (2, 2)."""
    low, high = bounds
    axes = [_centred(a, b) for a, b in zip(low, high, strict=True)]
    yaw = np.arange(YAWS) * (2 * np.pi / YAWS)
    grid = np.meshgrid(np.arange(num_placements), *axes, yaw, indexing="ij")
    return grid[0].ravel(), np.stack([g.ravel() for g in grid[1:]], axis=1)


def _centred(low: float, high: float) -> FloatArray:
    half = int((high - low) / SPACING) * SPACING / 2
    return (low + high) / 2 + np.linspace(-half, half, round(2 * half / SPACING) + 1)


def _read(path: Path, shape: tuple[int, int]) -> NDArray[np.float32] | None:
    try:
        stored = np.load(path, allow_pickle=False)
    except UNREADABLE_ARRAYS:
        return None
    good = stored.shape == shape and stored.dtype == np.float32 and bool(np.isfinite(stored).all())
    return stored if good else None


def shared_cost(mass: Any) -> Any:
    """Return ``-log(1 - exp(-m))``, the negative log-probability that some of `m` expected grasps is shared."""
    return -np.log(-np.expm1(-np.maximum(mass, 1e-9)))


def lattice_starts(
    lattice: PoseLattice,
    objective: SequenceObjective,
    num_regrasps: int,
    count: int,
    rng: np.random.Generator,
) -> Candidates:
    """Return up to `count` chains of `num_regrasps` lattice poses, the most promising and different ones first.

    Those with a pair below the `LEAST_CHANCE` are left out, so there may be none.
    """
    alpha = objective.options.alpha
    P = lattice.likelihoods(alpha)
    reach = [P @ np.exp(-end / alpha).astype(np.float32) for end in (objective.start_energy, objective.goal_energy)]
    from_start, to_goal = (shared_cost(mass) for mass in reach)
    if num_regrasps == 1:
        chains, cost = np.arange(len(P))[:, None], from_start + to_goal
    else:
        chains, cost = _chains(P, from_start, to_goal, num_regrasps, rng)
    order = np.argsort(cost, kind="stable")[:RANKED]
    ranked = chains[order]
    chosen = ranked[_different(lattice.cells[ranked], count)]
    energies = objective.chain(lattice.energies[chosen].astype(np.float64))
    shared = np.exp(-(energies[:, :-1] + energies[:, 1:])).sum(axis=2)
    worth = (shared_cost(shared) < -np.log(LEAST_CHANCE)).all(axis=1)
    chosen = chosen[worth]
    cost = sequence_cost(energies[worth], objective.options)
    return Candidates(lattice.placements[chosen], lattice.xi[chosen], cost)


def _chains(
    P: NDArray[np.float32],
    from_start: NDArray[Any],
    to_goal: NDArray[Any],
    num_regrasps: int,
    rng: np.random.Generator,
) -> tuple[IntArray, NDArray[Any]]:
    """Return the best chain through each pair of last two poses, (M * M, N), and its cost."""
    first, last = _layer(from_start, rng), _layer(to_goal, rng)
    value, trail = from_start[first], first[:, None]
    for _ in range(num_regrasps - 2):
        middle = _layer(rng.random(len(P)), rng)
        total = value[:, None] + shared_cost(P[trail[:, -1]] @ P[middle].T)
        parent = total.argmin(axis=0)
        value, trail = total[parent, np.arange(len(middle))], np.column_stack([trail[parent], middle])
    total = value[:, None] + shared_cost(P[trail[:, -1]] @ P[last].T) + to_goal[last]
    keep = np.argpartition(total, min(total.size - 1, RANKED), axis=None)[:RANKED]
    rows, columns = np.unravel_index(keep, total.shape)
    return np.column_stack([trail[rows], last[columns]]), total[rows, columns]


def _layer(cost: NDArray[Any], rng: np.random.Generator) -> IntArray:
    """Return `MIDDLE` poses: the cheapest quarter of that, and a random choice from what is still reachable."""
    order = np.argsort(cost, kind="stable")
    reachable = order[: max(MIDDLE, int((cost < 3.0).sum()))]
    if len(reachable) <= MIDDLE:
        return reachable
    head = MIDDLE // 4
    rest = rng.choice(reachable[head:], MIDDLE - head, replace=False)
    return np.concatenate([reachable[:head], rest])


def _different(cells: IntArray, count: int) -> IntArray:
    """Return up to `count` positions in a ranking of chains: the best chain of each coarse cell (C, N) first."""
    first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    rest = np.setdiff1d(np.arange(len(cells)), first)
    return np.concatenate([first, rest])[:count]


@dataclass(frozen=True)
class LatticeRefiner:
    """Take the start points as they are: with lattice starts, the planner that searches the lattice alone."""

    @property
    def name(self) -> str:
        """Short name, for reports."""
        return "lattice"

    def refine(self, objective: SequenceObjective, starts: Candidates, rng: np.random.Generator) -> Refinement:
        """Return `starts` unchanged."""
        return Refinement(
            starts, ("kept",) * len(starts), tuple(starts.cost[:, None]), {"candidates": len(starts), "evaluations": 0}
        )
