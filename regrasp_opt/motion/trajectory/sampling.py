"""RRT-Connect: a collision-free polyline between two configurations where the straight line collides.

Two trees grow towards each other from both ends (Kuffner and LaValle, 2000); the polyline is then shortened by random
cuts. Distances are bounds on how far any point moves [m], so a step is as long for the shoulder as for the wrist.
Edges are sampled; another module verifies the final trajectory.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory.collision_context import LEVELS, CollisionContext

STEP = 1.2
"""Longest step of a tree: how far any point may move [m]."""

SPACING = 0.02
"""Motion between samples of an edge [m]."""

CUTS = 20
"""Random cuts by which a polyline is shortened."""

SHORTEST = 2
"""Samples by which a step that meets an obstacle must advance to count."""

MARGIN_LEVEL = 4
"""Level whose distances the samples keep, where the ends do."""

_MARGIN = 1.2
"""How far beyond the two ends joints are drawn [rad, m]."""


def polyline(
    context: CollisionContext,
    start: FloatArray,
    goal: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
    *,
    iterations: int,
) -> FloatArray | None:
    """Return the corners (C, dof) of a polyline from `start` to `goal` (dof,), or None after `iterations`.

    Parameters
    ----------
    limits : two (dof,) arrays
        Lower and upper joint limits.
    """
    level = MARGIN_LEVEL if all(context.passes(q, MARGIN_LEVEL) for q in (start, goal)) else len(LEVELS) - 1
    edges = _Edges(context, level)
    if edges.free(start, goal):
        return np.array([start, goal])
    low = np.maximum(limits[0], np.minimum(start, goal) - _MARGIN)
    high = np.minimum(limits[1], np.maximum(start, goal) + _MARGIN)
    trees = [_Tree(end, iterations + 1) for end in (start, goal)]
    for i in range(iterations):
        growing, other = trees[i % 2], trees[1 - i % 2]
        fresh = edges.grow(growing, rng.uniform(low, high), STEP)
        if fresh is None:
            continue
        met = edges.grow(other, growing.nodes[fresh], np.inf)
        if met is None or not np.array_equal(other.nodes[met], growing.nodes[fresh]):
            continue
        halves = growing.branch(fresh), other.branch(met)
        first, second = halves if i % 2 == 0 else halves[::-1]
        return _shortened(np.array([*first[::-1], *second[1:]]), edges, rng)
    return None


class _Tree:
    """Configurations with the number of the one before each; the root has -1."""

    def __init__(self, root: FloatArray, size: int) -> None:
        self.nodes = np.tile(root, (size, 1))
        self._parents = [-1]

    def nearest(self, q: FloatArray, context: CollisionContext) -> int:
        return int(context.travel(self.nodes[: len(self._parents)] - q).argmin())

    def add(self, q: FloatArray, parent: int) -> int:
        self._parents.append(parent)
        self.nodes[len(self._parents) - 1] = q
        return len(self._parents) - 1

    def branch(self, node: int) -> list[FloatArray]:
        """Return the configurations from `node` back to the root."""
        found = []
        while node >= 0:
            found.append(self.nodes[node])
            node = self._parents[node]
        return found


class _Edges:
    def __init__(self, context: CollisionContext, level: int) -> None:
        self._context, self._level = context, level

    def free(self, a: FloatArray, b: FloatArray) -> bool:
        """Return whether samples between `a` and `b` (dof,), both ends left out, are free of collision."""
        count = int(np.ceil(float(self._context.travel(b - a)) / SPACING))
        parts = np.arange(1, count) / max(count, 1)
        order = np.argsort(np.abs(parts - 0.5), kind="stable")  # collisions are likelier away from the free ends
        return all(self._context.passes(a + u * (b - a), self._level) for u in parts[order].tolist())

    def grow(self, tree: _Tree, target: FloatArray, longest: float) -> int | None:
        """Grow `tree` towards `target` (dof,) while that is free, nothing moving farther than `longest` [m].

        Returns the new node, or None if nothing was gained.
        """
        near = tree.nearest(target, self._context)
        change = target - tree.nodes[near]
        distance = float(self._context.travel(change))
        count = int(np.ceil(distance / SPACING))
        steps = count if distance <= longest else int(longest / SPACING)
        free = 0
        while free < steps and self._context.passes(tree.nodes[near] + change * ((free + 1) / count), self._level):
            free += 1
        if free < min(steps, SHORTEST):
            return None
        return tree.add(target if free == count else tree.nodes[near] + change * (free / count), near)


def _shortened(corners: FloatArray, edges: _Edges, rng: np.random.Generator) -> FloatArray:
    """Return `corners` (C, dof) after random cuts between points of the polyline."""
    corners = _without_idle(corners, edges)
    for _ in range(CUTS):
        if len(corners) <= 2:
            break
        i, j = np.sort(rng.choice(len(corners) - 1, 2, replace=False))
        a, b = (
            corners[k] + u * (corners[k + 1] - corners[k]) for k, u in zip((i, j), rng.uniform(size=2), strict=True)
        )
        if edges.free(a, b):
            corners = np.concatenate([corners[: i + 1], [a, b], corners[j + 1 :]])
    return _without_idle(corners, edges)


def _without_idle(corners: FloatArray, edges: _Edges) -> FloatArray:
    """Return `corners` without those that can be skipped, as many at once as possible."""
    kept = [0]
    while kept[-1] < len(corners) - 1:
        here = kept[-1]
        further = range(len(corners) - 1, here + 1, -1)
        kept.append(next((k for k in further if edges.free(corners[here], corners[k])), here + 1))
    return corners[kept]
