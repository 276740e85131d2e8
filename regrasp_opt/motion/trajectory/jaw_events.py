"""What the jaw, or the vacuum, is told to do during a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from regrasp_opt.motion.motion_data import Phase, Segment


@dataclass(frozen=True)
class Squeeze:
    """How a jaw is told to hold an object.

    Attributes
    ----------
    below_contact : float
        How far below the grasp's width the jaw is told to close [m], for a jaw that goes where it is told.
    force : float, optional
        With which force it is told to close [N], for a jaw that takes one.
    """

    below_contact: float = 0.0
    force: float | None = None


@dataclass(frozen=True)
class JawEvent:
    """A command to the jaw or the vacuum.

    Attributes
    ----------
    time, duration : float
        When the jaw begins to move, from the beginning of the motion, and how long that takes [s].
    width_from, width_to : float
        Openings at its beginning and end, between which it changes evenly [m]; 0 for suction. They were verified.
    command : float
        The opening to ask for at its end [m]: `width_to`, or less where the object is to be squeezed.
    force : float or None
        The force to ask for [N], if one was given and the object is to be squeezed.
    holds : bool
        Whether the object is held from its end on; for suction, whether the vacuum is on from its beginning on.
    """

    time: float
    duration: float
    width_from: float
    width_to: float
    command: float
    force: float | None
    holds: bool


def jaw_events(segments: Sequence[Segment], squeeze: Squeeze) -> tuple[JawEvent, ...]:
    """Return what the jaw is told in a motion of `segments`; the first event says how it must stand as that begins."""
    events, began = list[JawEvent](), 0.0
    for number, segment in enumerate(segments):
        (width_from, width_to), duration = segment.jaw, segment.trajectory.duration
        if number == 0:
            events.append(JawEvent(0.0, 0.0, width_from, width_from, width_from, None, False))
        if segment.phase is Phase.GRASP:
            command = max(0.0, width_to - squeeze.below_contact)
            events.append(JawEvent(began, duration, width_from, width_to, command, squeeze.force, True))
        elif segment.phase is Phase.RELEASE or width_from != width_to:
            events.append(JawEvent(began, duration, width_from, width_to, width_to, None, False))
        began += duration
    return tuple(events)
