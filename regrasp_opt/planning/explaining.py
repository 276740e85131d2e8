"""`explain`: looks for the reasons why there is no plan, and tries what would help.

Counts come from `diagnose`, and what would have to go from `obstructions`, of every grasp at every pose. Remedies are
tried in `regrasp_opt.planning.remedies`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, invert
from regrasp_opt.errors import PoseError
from regrasp_opt.feasibility.diagnosis import OBSTACLES, Cause, Reason, diagnose, obstructions, tally
from regrasp_opt.feasibility.standing import nearest_board
from regrasp_opt.feasibility.tabletop import points_in_support
from regrasp_opt.planning.ends import checked_end
from regrasp_opt.planning.explanation import (
    Change,
    Counts,
    Explanation,
    PairExplanation,
    PoseExplanation,
    Remedy,
    regrasps,
)
from regrasp_opt.planning.pose_text import describe_pose
from regrasp_opt.planning.problem_data import ProblemData
from regrasp_opt.planning.remedies import Remedies
from regrasp_opt.scene import Fixture
from regrasp_opt.threads import one_blas_thread


class _Seen(NamedTuple):
    """One pose: which grasps (G,) are feasible, why the others are not, and all that is in the way of each."""

    told: PoseExplanation
    feasible: BoolArray
    failures: list[Reason | None]
    blocked: list[list[frozenset[Reason]]]


def explain(
    problem: ProblemData,
    poses: Sequence[FloatArray],
    message: str,
    *,
    solved: bool = False,
    tried: int = 0,
    remedies: bool = True,
    time_limit: float = 30.0,
    seed: int = 0,
) -> Explanation:
    """Return why there is no plan through `poses` (4, 4), start and goal first and last, or no grasp at the only one.

    Parameters
    ----------
    message : str
        How planning ended; "" for one pose.
    solved : bool
        Whether there is a plan; nothing is to blame then.
    tried : int
        Up to how many regrasps a plan was looked for.
    remedies : bool
        Whether to try what would help.
    time_limit : float
        Seconds after which no further remedy is tried.
    seed : int
        Seed of all that is drawn.
    """
    names = ["pose"] if len(poses) == 1 else ["start", *(f"pose {i}" for i in range(1, len(poses) - 1)), "goal"]
    with one_blas_thread():
        seen = [_look(problem, name, T) for name, T in zip(names, poses, strict=True)]
        pairs = tuple(_pair(a, b) for a, b in pairwise(seen))
        ends = [seen[0], seen[-1]] if len(seen) > 1 else seen
        causes = tuple(dict.fromkeys(cause for end in ends for cause in end.told.causes))
        if not causes and not solved and any(pair.shared == 0 for pair in pairs):
            causes = (Reason(Cause.NOT_SHARED),)
        told = tuple(each.told for each in seen)
        found = Explanation(message or str(told[0]), told, pairs, causes)
        if not causes and not solved and len(pairs) > 1:  # the time ran out before these poses were verified
            outcome = f"the poses that it found are a plan with {regrasps(len(pairs) - 1)}"
            in_time = Remedy(Change.SEARCH, "more time", True, outcome, len(pairs) - 1, {"time_limit": None})
            return replace(found, remedies=(in_time,))
        if solved or not remedies or not causes:
            return found
        return Remedies(problem, tried, time_limit, seed).completed(found)


def _look(problem: ProblemData, name: str, T: FloatArray) -> _Seen:
    refused = None
    try:
        checked_end(T, "given" if name == "pose" else name, problem)
    except PoseError as error:
        refused = str(error)
    failures, blocked = diagnose(problem.checker, T), obstructions(problem.checker, T)
    feasible = np.array([failure is None for failure in failures])
    told = PoseExplanation(
        name,
        T,
        describe_pose(T, problem),
        refused,
        len(failures),
        int(feasible.sum()) if refused is None else 0,
        dict(tally(failures).most_common()),
        _but_for(blocked),
        _causes(problem, T, refused, failures, blocked),
    )
    return _Seen(told, feasible, failures, blocked)


def _single(blocked: list[frozenset[Reason]]) -> dict[str, Reason]:
    """Return the things each of which alone keeps one grasp from being feasible, with how it does."""
    things = [({reason.thing for reason in reasons}, reasons) for reasons in blocked]
    return {min(names): min(reasons, key=str) for names, reasons in things if len(names) == 1}


def _but_for(blocked: list[list[frozenset[Reason]]]) -> Counts:
    return dict(Counter(thing for sets in blocked for thing in _single(sets)).most_common())


def _causes(
    problem: ProblemData,
    T: FloatArray,
    refused: str | None,
    failures: list[Reason | None],
    blocked: list[list[frozenset[Reason]]],
) -> tuple[Reason, ...]:
    """Return what to blame where no grasp is feasible: what a single removal shows, else what fails most often.

    Obstacles come first, as they could be elsewhere. The table is to blame if it leaves no grasp: that is so wherever
    the object is moved in this placement.
    """
    kinds = {f and f.cause for f in failures}
    if kinds in ({Cause.OBJECT}, {Cause.OUT_OF_REACH}):
        return tuple({f for f in failures if f is not None})
    if refused is not None or None in failures:
        return (Reason(Cause.REFUSED),) if refused is not None else ()
    left = np.flatnonzero(~_in_support(problem, T)).tolist()
    if not left:
        return (Reason(Cause.GRIPPER_IN_TABLE),)
    alone = [_single(blocked[k]) for k in left]
    freed = Counter(thing for things in alone for thing in things)
    often = tally(failures).most_common()
    if set(freed) == {"table"}:
        return tuple(reason for reason, _ in often if reason.thing == "table") or (Reason(Cause.GRIPPER_IN_TABLE),)
    if freed:
        told = {thing: reason for things in alone for thing, reason in things.items()}
        told |= {reason.thing: reason for reason, _ in reversed(often) if reason.thing in freed}
        return tuple(sorted(told.values(), key=lambda r: (r.cause not in OBSTACLES, -freed[r.thing])))
    sets = [reasons for k in left for reasons in blocked[k]]
    if not sets or 2 * sum(not blocked[k] for k in left) >= len(left):
        return (Counter(reason for k in left if (reason := failures[k]) is not None).most_common(1)[0][0],)
    fewest = min(map(len, sets))
    smallest = Counter(reasons for reasons in sets if len(reasons) == fewest).most_common(1)[0][0]
    return tuple(sorted(smallest, key=lambda r: (r.cause not in OBSTACLES, str(r))))


def _in_support(problem: ProblemData, T: FloatArray) -> BoolArray:
    """Return which grasps (G,) put gripper or wrist into the board that the object is on, or nearest to."""
    number = problem.checker.support_below(T)
    own = nearest_board(T, problem.object, problem.workcell) if number is None else problem.workcell.supports[number]
    if isinstance(own, Fixture):
        return np.zeros(len(problem.grasps), dtype=bool)
    points = points_in_support(problem.workcell, problem.grasps, (invert(own.T_world_support) @ T)[None], [own])[0]
    inside: BoolArray = ((points >= own.edges[0]) & (points <= own.edges[1])).all(axis=1)  # NaN where there is none
    return inside


def _pair(a: _Seen, b: _Seen) -> PairExplanation:
    counts = [
        dict(tally(there.failures[k] for k in np.flatnonzero(here.feasible & ~there.feasible)).most_common())
        for here, there in ((a, b), (b, a))
    ]
    alone = [
        there.blocked[k] for here, there in ((a, b), (b, a)) for k in np.flatnonzero(here.feasible & ~there.feasible)
    ]
    shared = int((a.feasible & b.feasible).sum())
    return PairExplanation((a.told.name, b.told.name), shared, counts[0], counts[1], _but_for(alone))
