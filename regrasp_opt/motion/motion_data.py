"""What the arm and the jaw do, one segment after the other, to carry out a regrasp plan."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from regrasp_opt.motion.trajectory.trajectory import Trajectory


class Phase(Enum):
    """What a segment is for; the value says it."""

    REACH = "the arm moves with an empty jaw to where the approach begins"
    APPROACH = "the open jaw moves along a straight line to the grasp"
    GRASP = "the jaw closes, the arm rests"
    LIFT = "the object is lifted along a straight line"
    TRANSFER = "the object is carried to above its next pose"
    LOWER = "the object is lowered along a straight line"
    RELEASE = "the jaw opens, the arm rests"
    RETREAT = "the open jaw moves back along a straight line"
    RETURN = "the arm returns home"

    @property
    def holds(self) -> bool:
        """Whether the object moves with the hand."""
        return self in (Phase.LIFT, Phase.TRANSFER, Phase.LOWER)

    @property
    def doing(self) -> str:
        """What the arm is doing, as in "while lifting"."""
        return {Phase.TRANSFER: "transferring", Phase.RELEASE: "releasing"}.get(self, f"{self.name.lower()}ing")


class MotionStatus(Enum):
    """How motion planning ended; the value is the sentence to show, and says what to try next."""

    SOLVED = "solved: every segment was verified free of collision and within the joint limits"
    NO_PLAN = "the regrasp plan is not solved, so there is nothing to move; plan again first"
    HOME_BLOCKED = "the home configuration collides; choose another home, or None"
    NO_MOTION = (
        "no shared grasp of a transition allows a motion; try plan_with_motion, more iterations, or shorter distances"
    )


@dataclass(frozen=True, eq=False)
class Segment:
    """A part of a motion; the arm rests while the jaw closes or opens.

    Attributes
    ----------
    phase : Phase
    transition : int
        Number of the plan's transition; for the way home that of the last one.
    grasp_id : int
        Number into ``problem.grasps`` of the transition's grasp.
    trajectory : Trajectory
    jaw : (float, float)
        Opening of the jaw at the beginning and at the end [m]; 0 for suction.
    """

    phase: Phase
    transition: int
    grasp_id: int
    trajectory: Trajectory
    jaw: tuple[float, float]
