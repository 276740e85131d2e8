"""A lattice of poses with all their energies: chains of lattice poses as start points, or as plans of their own.

With ``P = exp(-E / alpha)`` (poses x grasps) the pair score is an inner product,
``Q_pair(a, b) = -alpha log(P_a . P_b)`` (Eq. 4), so every one-step bridge costs two matrix-vector products and longer
chains are dynamic programming over blocks of ``P P^T``. Memory: L x G float32 for the lattice, and a few blocks of
`MIDDLE` x `MIDDLE` for chains.

A pair with ``m = P_a . P_b`` expected shared grasps has at least one with probability about ``1 - exp(-m)``; chains are
ranked by the negative log of that, which does not let an abundant pair make up for an empty one.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp_opt.connectivity import BLOCKED, SequenceObjective, block
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.geometry.planar_poses import PlanarPoses
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
_GRASPS = 50
"""Grasps that are evaluated at once at a placement and yaw, so that a layer stays in the cache."""
_PORTION = 24
"""Chains of a ranking whose poses are asked about together, at least."""
_RANKINGS = 3
"""Times that chains are ranked at most, while poses that are ranked first are still being asked about."""
_HOPELESS = 10.0
"""Energy above which a grasp need not be asked about: 200 of them are worth a hundredth of a grasp."""


FreeRule = Callable[[IntArray, FloatArray], BoolArray]
"""Returns which grasps (L, G) are ruled out at `placements` (L,) and `xi` (L, 3)."""
PromiseRule = Callable[[IntArray, FloatArray, BoolArray], BoolArray]
"""Returns which of the candidates (B, G) are ruled out at `placements` (B,) and `xi` (B, 3)."""


@dataclass(frozen=True, eq=False)
class PoseLattice:
    """L poses: ``placements`` (L,), ``xi`` (L, 3) and their energies (L, G) in single precision.

    A `rule` that costs more than an energy is not asked about all of them, but when a pose is about to be used, about
    its grasps that are useful and have any promise (`settle`).
    """

    placements: IntArray
    xi: FloatArray
    energies: NDArray[np.float32]
    rule: PromiseRule | None = None
    source: PoseLattice | None = None
    _likelihoods: dict[float, NDArray[np.float32]] = field(default_factory=dict)

    def likelihoods(self, alpha: float) -> NDArray[np.float32]:
        """Return ``P = exp(-E / alpha)`` (L, G)."""
        if self.source is not None and not self._settled.any():
            return self.source.likelihoods(alpha)
        if alpha not in self._likelihoods:
            self._likelihoods[alpha] = _likelihood(self.energies, alpha)
        return self._likelihoods[alpha]

    def under(self, rule: PromiseRule | None) -> PoseLattice:
        """Return a copy for one search that asks `rule`, too: what it learns of poses would change the next search."""
        return PoseLattice(self.placements, self.xi, self.energies.copy(), rule, self)

    def part(self, poses: BoolArray, grasps: BoolArray) -> PoseLattice:
        """Return a copy with these `poses` (L,) only, in which all but these `grasps` (G,) are `BLOCKED`."""
        energies = self.energies[poses]
        energies[:, ~grasps] = BLOCKED
        copied = PoseLattice(self.placements[poses], self.xi[poses], energies)
        for alpha, P in self._likelihoods.items():
            copied._likelihoods[alpha] = P[poses]
            copied._likelihoods[alpha][:, ~grasps] = np.exp(-np.float32(BLOCKED / alpha))
        return copied

    @cached_property
    def _settled(self) -> BoolArray:
        return np.zeros(self.energies.shape, dtype=bool)

    def settle(self, poses: IntArray, grasps: IntArray) -> IntArray:
        """Block those of the `grasps` that the rule rules out at `poses`; return the poses that were asked about now.

        Poses are numbers (...), grasps (A,); a pose is asked about a grasp only once.
        """
        if self.rule is None:
            return np.zeros(0, dtype=np.int64)
        asked = np.unique(poses)
        at = asked[:, None], grasps
        candidates = np.zeros((len(asked), self.energies.shape[1]), dtype=bool)
        candidates[:, grasps] = ~self._settled[at]
        self._settled[at] = True
        new = candidates.any(axis=1)
        asked, candidates = asked[new], candidates[new]
        if len(asked):
            candidates &= self.energies[asked] < _HOPELESS
            self.block(asked, self.rule(self.placements[asked], self.xi[asked], candidates))
        return asked

    def block(self, poses: IntArray, ruled_out: BoolArray) -> None:
        """Block the grasps (K, G) that are `ruled_out` at `poses`, K different numbers; not in what others may use."""
        self._settled[poses] |= ruled_out
        self.energies[poses] = block(self.energies[poses], ruled_out)
        for alpha, P in self._likelihoods.items():
            P[poses] = _likelihood(self.energies[poses], alpha)

    def number(self, placement: int, xi: FloatArray) -> int:
        """Return the number of a pose of this lattice, given by its placement and `xi` (3,)."""
        return int(np.flatnonzero((self.placements == placement) & (self.xi == xi).all(axis=1))[0])

    @cached_property
    def cells(self) -> IntArray:
        """The coarse cell (L,) of each pose: its placement, a square of three spacings and a quarter turn."""
        if self.source is not None:
            return self.source.cells
        x, y = (np.floor(self.xi[:, k] / (3 * SPACING)).astype(np.int64) for k in (0, 1))
        quarter = np.floor(self.xi[:, 2] / (np.pi / 2)).astype(np.int64)
        return np.unique(np.column_stack([self.placements, x, y, quarter]), axis=0, return_inverse=True)[1]

    @staticmethod
    def build(energy: GraspEnergy, placements: PlanarPoses, rule: FreeRule | None = None) -> PoseLattice:
        """Evaluate `energy` on the lattice over the `placements` and their limits.

        Grasps that `rule` rules out are `BLOCKED`; where it does so at all positions of a placement and yaw, the energy
        is not evaluated.
        """
        numbers, xi = lattice_poses(placements)
        ruled_out = np.zeros((len(xi), len(energy)), dtype=bool) if rule is None else rule(numbers, xi)
        energies = np.full(ruled_out.shape, BLOCKED, dtype=np.float32)
        edges, layers = np.searchsorted(numbers, np.arange(len(placements) + 1)), energy.planar_layers(placements)

        def evaluate(number: int) -> None:
            layer, part = layers[number], slice(*edges[number : number + 2])
            yaws = int(np.unique(xi[part, 2]).size)
            grid, found, closed = (each[part].reshape(-1, yaws, each.shape[1]) for each in (xi, energies, ruled_out))
            shift = (grid[:, 0, :2] @ np.hstack([layer.dx, layer.dy]).T).astype(np.float32)  # (P, H)
            for k, yaw in enumerate(grid[0, :, 2]):
                kept = np.flatnonzero(~closed[:, k].all(axis=0))
                turned = layer.constant + np.cos(yaw) * layer.cosine + np.sin(yaw) * layer.sine  # (H, G)
                for first in range(0, len(kept), _GRASPS):
                    some = kept[first : first + _GRASPS]
                    z = turned[:, some].T.astype(np.float32) + shift[:, None]  # (P, g, H)
                    value = energy.after_first_layer(z.reshape(-1, z.shape[2]))
                    found[:, k, some] = value.reshape(len(grid), -1)

        with ThreadPoolExecutor(_WORKERS) as pool:
            list(pool.map(evaluate, range(len(placements))))
        return PoseLattice(numbers, xi, block(energies, ruled_out))


def _likelihood(energies: NDArray[np.float32], alpha: float) -> NDArray[np.float32]:
    found: NDArray[np.float32] = np.exp(-energies / np.float32(alpha))
    return found


def lattice_poses(placements: PlanarPoses) -> tuple[IntArray, FloatArray]:
    """Return placement numbers (L,) and planar parameters (L, 3) of a regular lattice within the limits."""
    grids = [_grid(*limits) for limits in zip(placements.low, placements.high, strict=True)]
    return np.repeat(np.arange(len(grids)), list(map(len, grids))), np.concatenate(grids)


def _grid(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return planar parameters (P, 3); the yaws of a position follow each other."""
    x, y = (_centred(a, b) for a, b in zip(low[:2], high[:2], strict=True))
    yaw = low[2:] if np.isfinite(low[2]) else np.arange(YAWS) * (2 * np.pi / YAWS)
    return np.stack(np.meshgrid(x, y, yaw, indexing="ij"), axis=-1).reshape(-1, 3)


def _centred(low: float, high: float) -> FloatArray:
    half = int((high - low) / SPACING) * SPACING / 2
    return (low + high) / 2 + np.linspace(-half, half, round(2 * half / SPACING) + 1)


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
    useful, alpha = objective.useful_grasps(num_regrasps), objective.options.alpha
    ends = [np.exp(-end / alpha).astype(np.float32) for end in (objective.start_energy, objective.goal_energy)]
    reach = np.stack([lattice.likelihoods(alpha) @ end for end in ends])
    for _ in range(1 if lattice.rule is None else _RANKINGS):
        ranked = _ranked(lattice, objective, reach, num_regrasps, copy.deepcopy(rng))
        found, known, first = ranked[:0], True, 0
        while len(found) < count and first < len(ranked):
            size = max(count, first, 1 if lattice.rule is None else _PORTION)
            portion = _worth(lattice, objective, ranked[first : first + size])
            first += size
            asked = lattice.settle(portion, useful)
            if len(asked):
                reach[:, asked] = [_likelihood(lattice.energies[asked], alpha) @ end for end in ends]
                known, portion = False, _worth(lattice, objective, portion)
            found = np.concatenate([found, portion])
        if known:  # what was ranked first is what it seemed to be
            break
    found = found[:count]
    numbers = lattice.placements[found]
    cost = objective.sequence_cost(numbers, lattice.energies[found].astype(np.float64))
    return Candidates(numbers, lattice.xi[found], cost)


def _ranked(
    lattice: PoseLattice,
    objective: SequenceObjective,
    reach: NDArray[np.float32],
    num_regrasps: int,
    rng: np.random.Generator,
) -> IntArray:
    """Return chains (C, N) of poses by their chance, the best of each coarse cell first.

    `reach` (2, L) are the expected shared grasps of each pose with start and goal.
    """
    from_start, to_goal = shared_cost(reach)
    weights = objective.placements.weights[lattice.placements]
    if num_regrasps == 1:
        chains, cost = np.arange(reach.shape[1])[:, None], from_start + to_goal
    else:
        chains, cost = _chains(lattice.likelihoods(objective.options.alpha), from_start, to_goal, num_regrasps, rng)
    if weights.any():
        cost = cost + weights[chains].sum(axis=1)
    ranked = chains[np.argsort(cost, kind="stable")[:RANKED]]
    return ranked[_different(lattice.cells[ranked])]


def _worth(lattice: PoseLattice, objective: SequenceObjective, chains: IntArray) -> IntArray:
    """Return those of the `chains` (C, N) none of whose pairs is below the `LEAST_CHANCE`."""
    energies = objective.chain(lattice.energies[chains])
    shared = np.exp(-(energies[:, :-1] + energies[:, 1:])).sum(axis=2)
    return chains[(shared_cost(shared) < -np.log(LEAST_CHANCE)).all(axis=1)]


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


def _different(cells: IntArray) -> IntArray:
    """Return the positions in a ranking of chains such that the best chain of each coarse cell (C, N) comes first."""
    key = cells[:, 0]
    for column in cells.T[1:]:
        key = np.unique(key, return_inverse=True)[1] * (cells.max() + 1) + column
    first = np.zeros(len(cells), dtype=bool)
    first[np.unique(key, return_index=True)[1]] = True
    return np.concatenate([np.flatnonzero(first), np.flatnonzero(~first)])


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
