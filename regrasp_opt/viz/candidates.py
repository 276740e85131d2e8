"""The candidates of a refiner by iteration, from start points to refined poses, and where they moved over the table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import OptionError
from regrasp_opt.planning import Recipe, RegraspPlan, Status, solve_sequence
from regrasp_opt.planning.recipes import as_recipe
from regrasp_opt.solvers import RecordedBatch, RecordingRefiner, Refiner
from regrasp_opt.viz.surfaces import Patch

SHOWN = 12
"""Candidates that are shown at most, the cheapest refined ones."""
RANGE = 10.0
"""Costs that are farther than this above the least are drawn alike: there the model expects no shared grasp."""
LIFT = 0.0016
"""Height of a trail above its support [m]."""
TRAIL = 0.005
"""Width of a trail [m]."""


@dataclass(frozen=True, eq=False)
class CandidateTrace:
    """B candidates with N intermediate poses each, in K frames: the start points, each iteration, the refined poses.

    A candidate that needed fewer iterations than others stays where it ended.

    Attributes
    ----------
    refiner : str
        Name of the refiner.
    xi : (K, B, N, 3)
        Planar parameters [m, m, rad].
    poses : (K, B, N, 4, 4)
        T_world_object.
    cost : (K, B)
        `J_seq` (Eq. 5).
    accepted : int or None
        Number of the candidate that became the plan; None if none did.
    surfaces : (B, N, 4, 4)
        T_world_support of each pose.
    """

    refiner: str
    xi: FloatArray
    poses: FloatArray
    cost: FloatArray
    accepted: int | None
    surfaces: FloatArray

    def label(self, frame: int) -> str:
        """Return what frame number `frame` shows."""
        last = len(self.cost) - 1
        stage = "start points" if frame == 0 else "refined" if frame == last else f"iteration {frame} of {last - 1}"
        return f"{self.refiner}, {stage}: J_seq {self.cost[frame].min():.2f} to {self.cost[frame].max():.2f}"


def trace_candidates(plan: RegraspPlan, refiner: str | Refiner | Recipe = "ipopt") -> CandidateTrace:
    """Plan once more with `refiner` and the seed of `plan`, and return the candidates of the last N that was tried.

    Candidates are those of all batches of that N, at most `SHOWN`, the cheapest refined first; the accepted one is
    always among them. With the refiner that made the plan they are the plan's own.

    Raises
    ------
    OptionError
        If nothing was refined: start and goal share a grasp, one of them has none, or no poses have a chance.
    """
    recipe = as_recipe(refiner)
    recorder = RecordingRefiner(recipe.refiner)
    deepest = max([1, plan.num_regrasps, *(entry["num_regrasps"] for entry in plan.refiner_stats)])
    ends = plan.poses[0], plan.poses[-1]
    found = solve_sequence(plan.problem, *ends, replace(recipe, refiner=recorder), max_regrasps=deepest, seed=plan.seed)
    if not recorder.batches:
        why = {
            Status.SOLVED: "start and goal share a grasp",
            Status.NOT_FOUND: "no poses have a chance by the learned energies",
        }.get(found.status, "start or goal has no feasible grasp")
        raise OptionError(f"there are no candidates to show: {why}, so nothing was refined; show the plan without them")
    count = recorder.batches[-1].starts.xi.shape[1]
    return _trace(recorder.name, [b for b in recorder.batches if b.starts.xi.shape[1] == count], found)


def _trace(name: str, batches: list[RecordedBatch], found: RegraspPlan) -> CandidateTrace:
    objective = batches[0].objective
    refined = [b.refinement.candidates for b in batches]
    placements, xi, cost = (np.concatenate([getattr(c, key) for c in refined]) for key in ("placements", "xi", "cost"))
    order = np.argsort(cost, kind="stable")
    same = _accepted(placements, xi, found)
    kept = order[:SHOWN] if same is None or same in order[:SHOWN] else np.append(order[: SHOWN - 1], same)
    starts = np.concatenate([b.starts.xi for b in batches])
    known = [path for b in batches for path in b.refinement.paths or b.starts.xi[:, None]]
    paths = [path if len(path) else start[None] for path, start in zip(known, starts, strict=True)]
    length = max(len(paths[k]) for k in kept)
    frames = np.stack([[starts[k], *paths[k][1:], *[paths[k][-1]] * (length - len(paths[k])), xi[k]] for k in kept], 1)
    frames[-1, :, :, 2] = _nearest_turn(frames[-1, :, :, 2], frames[-2, :, :, 2])
    which = placements[kept]
    return CandidateTrace(
        name,
        frames,
        np.array([objective.poses(which, each) for each in frames]),
        np.array([objective.cost(which, each) for each in frames]),
        None if same is None else int(np.flatnonzero(kept == same)[0]),
        objective.placements.surfaces[which],
    )


def _accepted(placements: IntArray, xi: FloatArray, found: RegraspPlan) -> int | None:
    """Return which of the refined candidates is the plan that was found; None if it is an unrefined chain, or none."""
    if not found.solved or found.xi.shape != xi.shape[1:]:
        return None
    same = (placements == found.placements).all(axis=1) & (xi == found.xi).all(axis=(1, 2))
    return int(same.argmax()) if same.any() else None


def _nearest_turn(yaw: FloatArray, before: FloatArray) -> FloatArray:
    """Return `yaw` plus the full turns that bring it nearest to `before`."""
    nearest: FloatArray = yaw + 2 * np.pi * np.round((before - yaw) / (2 * np.pi))
    return nearest


def cost_range(trace: CandidateTrace) -> tuple[float, float]:
    """Return the costs at both ends of the colour scale: the least, and the greatest but at most `RANGE` above it."""
    low = float(trace.cost.min())
    return low, min(float(trace.cost.max()), low + RANGE)


def trail(trace: CandidateTrace) -> tuple[Patch, Any]:
    """Return ribbons on the supports along which the candidates moved, and the cost (V,) at each vertex.

    The 2 B N triangles of the first step come first, then those of the second, and so on.
    """
    at = trace.xi[..., :2].reshape(len(trace.xi), -1, 2)
    a, b = at[:-1], at[1:]
    along = b - a
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1) / np.maximum(length, 1e-12) * (TRAIL / 2)
    corners = np.stack([a - across, a + across, b + across, b - across], axis=2)  # (K-1, B N, 4, 2)
    T = trace.surfaces.reshape(-1, 4, 4)[:, None]  # (B N, 1, 4, 4)
    local = np.concatenate([corners, np.full((*corners.shape[:-1], 1), LIFT)], axis=-1)
    vertices = ((T[..., :3, :3] @ local[..., None])[..., 0] + T[..., :3, 3]).reshape(-1, 3)
    first = 4 * np.arange(len(vertices) // 4)[:, None, None]
    faces = (first + np.array([[0, 2, 1], [0, 3, 2]])).reshape(-1, 3)
    cost = np.repeat(trace.cost, trace.xi.shape[2], axis=1)
    return Patch(vertices, faces), np.stack([cost[:-1], cost[:-1], cost[1:], cost[1:]], axis=2).ravel()
