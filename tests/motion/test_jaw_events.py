"""Commands to the jaw: one for each thing that it does, at its time."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.errors import OptionError
from regrasp_opt.motion import MotionOptions, Phase, Squeeze, plan_motion


def test_there_is_one_for_each_grasp_and_release_and_change_of_opening(motion):
    events = motion.jaw_events
    assert (events[0].time, events[0].duration, events[0].holds) == (0.0, 0.0, False)
    moving = [
        (start, s)
        for start, s in zip(motion.starts, motion.segments, strict=True)
        if s.phase in (Phase.GRASP, Phase.RELEASE) or s.jaw[0] != s.jaw[1]
    ]
    assert len(events) == 1 + len(moving)
    for event, (start, segment) in zip(events[1:], moving, strict=True):
        assert event.time == pytest.approx(start) and event.duration == segment.trajectory.duration
        assert (event.width_from, event.width_to) == segment.jaw
        assert event.holds == (segment.phase is Phase.GRASP)
        below = motion.squeeze.below_contact if event.holds else 0.0
        assert event.command == pytest.approx(event.width_to - below) and event.force is None
    assert sum(event.holds for event in events) == len(motion.plan.transitions)
    assert all(a.width_to == b.width_from for a, b in itertools.pairwise(events))


def test_a_force_is_asked_for_while_it_holds_and_no_width_below_0(motion):
    firm = replace(motion, squeeze=Squeeze(1.0, 40.0))
    for event in firm.jaw_events:
        assert (event.force, event.command) == ((40.0, 0.0) if event.holds else (None, event.width_to))


def test_the_vacuum_is_switched_and_squeezes_nothing():
    problem = RegraspProblem.load("pentagon", "nova2-s1")
    plan = solve_sequence(problem, problem.pose(0, -0.2, 0.4, 0.0), problem.pose(0, 0.2, 0.4, 1.0))
    motion = plan_motion(plan, MotionOptions(force=20.0))
    assert motion.solved, motion.reason
    assert [event.holds for event in motion.jaw_events] == [False, *[True, False] * len(plan.transitions)]
    widths = [(e.width_from, e.width_to, e.command) for e in motion.jaw_events]
    assert not np.any(widths) and all(event.force is None for event in motion.jaw_events)


@pytest.mark.parametrize(
    "options", [{"squeeze": -0.001}, {"squeeze": np.nan}, {"squeeze": 0.2}, {"force": 0.0}, {"force": np.inf}]
)
def test_bad_options_are_refused(options):
    with pytest.raises(OptionError, match=next(iter(options))):
        MotionOptions(**options)
