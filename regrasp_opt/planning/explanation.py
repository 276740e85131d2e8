"""Why there is no plan, as data and as text: what `explain` found (`regrasp_opt.planning.explaining`).

Every count and every remedy is the outcome of an exact check that was made; nothing is guessed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import groupby
from typing import Any, NamedTuple

from regrasp_opt.conventions import FloatArray
from regrasp_opt.feasibility.diagnosis import Reason

SHOWN = 6
"""Reasons that a line of the text counts; the data has all."""

Counts = Mapping[Any, int]


class PoseExplanation(NamedTuple):
    """What keeps grasps from being feasible at one pose.

    Attributes
    ----------
    name : str
        "start", "pose 1", ..., "goal", or "pose".
    T : (4, 4)
        T_world_object.
    where : str
        The same as ``PLACEMENT:x,y,yaw_deg``.
    refused : str or None
        Why the object cannot be at this pose at all.
    grasps, feasible : int
        How many there are, and how many are feasible here; none, if the pose is refused.
    failures : mapping of Reason to int
        How many grasps fail for each reason, the most frequent first.
    but_for : mapping of str to int
        How many grasps would be feasible without one thing: an obstacle, the table, a joint's limit, the arm's own
        body, the object.
    causes : tuple of Reason
        Where no grasp is feasible: what to blame, the first before all others. Grasps that put gripper or wrist into
        the table, and fail wherever the object is moved, are not asked as long as there are others.
    """

    name: str
    T: FloatArray
    where: str
    refused: str | None
    grasps: int
    feasible: int
    failures: Counts
    but_for: Counts
    causes: tuple[Reason, ...]

    def __str__(self) -> str:
        """Return one line: where, how many are feasible, and why the others are not."""
        here = f"{self.name} {self.where}:"
        if self.refused is not None:
            return f"{here} {self.refused}"
        text = f"{here} {self.feasible or 'none'} of {self.grasps} grasps feasible"
        text += f"; {counted(self.failures)}" if self.failures else ""
        return text + (f"; but for one thing: {counted(self.but_for)}" if self.but_for else "")


class PairExplanation(NamedTuple):
    """What two neighbouring poses share, and why not more.

    Attributes
    ----------
    names : (str, str)
    shared : int
        Grasps that are feasible at both.
    at_second, at_first : mapping of Reason to int
        Why the grasps that are feasible at the first pose alone fail at the second, and the reverse.
    but_for : mapping of str to int
        How many more grasps would be shared without one thing.
    """

    names: tuple[str, str]
    shared: int
    at_second: Counts
    at_first: Counts
    but_for: Counts

    def __str__(self) -> str:
        """Return one line."""
        first, second = self.names
        text = f"{first} - {second}: {self.shared or 'no'} shared grasp{'' if self.shared == 1 else 's'}"
        for here, there, counts in ((first, second, self.at_second), (second, first, self.at_first)):
            text += f"; those of {here} fail at {there}: {counted(counts)}" if counts else ""
        return text + (f"; shared but for one thing: {counted(self.but_for)}" if self.but_for else "")


class Between(NamedTuple):
    """Random resting poses that were checked exactly, as poses between start and goal.

    Attributes
    ----------
    drawn, graspable : int
        How many there are, and how many of them have a feasible grasp.
    with_start, with_goal, with_both : int
        How many share a grasp with the start, with the goal, with both.
    placements_with_start, placements_with_goal : tuple of str
        The placements of those, as poses are written.
    num_regrasps : int or None
        Fewest regrasps of a plan through them; None if there is none.
    """

    drawn: int
    graspable: int
    with_start: int
    with_goal: int
    with_both: int
    placements_with_start: tuple[str, ...]
    placements_with_goal: tuple[str, ...]
    num_regrasps: int | None

    def __str__(self) -> str:
        """Return one line."""
        ends = [
            f"{count} share a grasp with the {name}" + (f" (placement {', '.join(placements)})" if placements else "")
            for name, count, placements in (
                ("start", self.with_start, self.placements_with_start),
                ("goal", self.with_goal, self.placements_with_goal),
            )
        ]
        drawn = f"{self.drawn} random resting poses: {self.graspable} can be grasped"
        return f"between: {drawn}, {', '.join(ends)}, {self.with_both} with both"


class Change(Enum):
    """What may be changed about a task; the value is how messages say it."""

    SEARCH = "another search"
    REGRASPS = "allowing more regrasps"
    OBSTACLE = "taking an obstacle away"
    PLACE = "another place"
    PLACEMENT = "another placement"
    GRASPS = "taking more grasps"
    TOOL = "another end-effector"


class Remedy(NamedTuple):
    """A change that was tried.

    Attributes
    ----------
    change : Change
    text : str
        What was changed.
    helps : bool
        Whether there is a plan then, with no more regrasps than were allowed if both ends can be grasped as they are.
        Where one pose is explained: whether there is a feasible grasp.
    outcome : str
        What the check found.
    num_regrasps : int or None
        Regrasps of that plan.
    value : dict
        The change as data: ``"start"`` and ``"goal"`` (4, 4) poses, ``"max_regrasps"``, ``"refiner"``, names of
        obstacles to take away as ``"without"``, ``"grasps"`` to sample with ``"seed"``, ``"end_effector"``, or
        ``"time_limit"``.
    """

    change: Change
    text: str
    helps: bool
    outcome: str
    num_regrasps: int | None
    value: Mapping[str, Any]


@dataclass(frozen=True)
class Explanation:
    """Why there is no plan, or no feasible grasp; ``str()`` gives the text.

    Attributes
    ----------
    message : str
        How planning ended, in one sentence; of one pose what the text says of it.
    poses : tuple of PoseExplanation
        Start, the poses between, goal; or the one pose that was asked about.
    pairs : tuple of PairExplanation
        Neighbouring poses.
    causes : tuple of Reason
        What to blame, the first before all others; empty for a plan that is solved and a pose with a feasible grasp.
    between : Between or None
    remedies : tuple of Remedy
        What was tried, those that help first.
    untried : tuple of Change
        What the time did not suffice for.
    """

    message: str
    poses: tuple[PoseExplanation, ...]
    pairs: tuple[PairExplanation, ...] = ()
    causes: tuple[Reason, ...] = ()
    between: Between | None = None
    remedies: tuple[Remedy, ...] = ()
    untried: tuple[Change, ...] = ()

    @property
    def helpful(self) -> tuple[Remedy, ...]:
        """The remedies that help."""
        return tuple(remedy for remedy in self.remedies if remedy.helps)

    def lines(self) -> list[str]:
        """Return the text line by line, without the message."""
        text = [f"cause: {', '.join(map(str, self.causes))}; {self.causes[0].cause.advice}"] if self.causes else []
        text += [str(each) for each in (*self.poses, *self.pairs)] if len(self.poses) > 1 else []
        text += [str(self.between)] if self.between else []
        for (helps, change), some in groupby(self.remedies, lambda remedy: (remedy.helps, remedy.change)):
            by_outcome = groupby(sorted(some, key=lambda remedy: remedy.outcome), lambda remedy: remedy.outcome)
            tried = [f"{', '.join(remedy.text for remedy in same)} ({outcome})" for outcome, same in by_outcome]
            text.append(f"{change.value} {'helps' if helps else 'does not help'}: {'; '.join(tried)}")
        names = ", ".join(change.value for change in self.untried)
        return text + ([f"not tried, as the time ran out: {names}"] if names else [])

    def __str__(self) -> str:
        """Return the text: the message, the cause, the counts, and what would help."""
        return "\n".join([self.message, *(f"  {line}" for line in self.lines())])

    def data(self) -> dict[str, Any]:
        """Return all of it as data that JSON can hold."""
        return {
            "message": self.message,
            "causes": [_reason(reason) for reason in self.causes],
            "poses": [
                each._asdict()
                | {"T": each.T.tolist(), "failures": _reasons(each.failures), "but_for": dict(each.but_for)}
                | {"causes": [_reason(reason) for reason in each.causes]}
                for each in self.poses
            ],
            "pairs": [
                each._asdict()
                | {"at_second": _reasons(each.at_second), "at_first": _reasons(each.at_first)}
                | {"names": list(each.names), "but_for": dict(each.but_for)}
                for each in self.pairs
            ],
            "between": self.between and self.between._asdict(),
            "remedies": [
                each._asdict() | {"change": each.change.name.lower(), "value": dict(each.value)}
                for each in self.remedies
            ],
            "untried": [change.name.lower() for change in self.untried],
        }


def counted(counts: Counts) -> str:
    """Return the `SHOWN` most frequent entries of `counts` with their numbers, and the number of the others."""
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    texts = [f"{count} {what}" for what, count in ordered[:SHOWN]]
    rest = sum(count for _, count in ordered[SHOWN:])
    return ", ".join(texts + ([f"{rest} otherwise"] if rest else []))


def regrasps(count: int) -> str:
    """Return `count` regrasps in words."""
    return f"{count} regrasp{'' if count == 1 else 's'}"


def _reason(reason: Reason) -> dict[str, Any]:
    return {"cause": reason.cause.name.lower(), "bodies": list(reason.bodies), "text": str(reason)}


def _reasons(counts: Counts) -> list[dict[str, Any]]:
    return [_reason(reason) | {"count": count} for reason, count in counts.items()]
