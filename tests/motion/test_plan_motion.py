"""`plan_motion` and `plan_with_motion`: what they promise, and what they say where they cannot."""

from dataclasses import replace

import numpy as np
import pytest
from verifying import motion_findings

from regrasp_opt import Recipe, Status, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import OptionError
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.motion import MotionOptions, MotionStatus, Phase, plan_motion, plan_with_motion
from regrasp_opt.motion.trajectory import connector as connections
from regrasp_opt.motion.trajectory import planner
from regrasp_opt.motion.trajectory.connector import Connector
from regrasp_opt.solvers import LatticeRefiner

FEW = Recipe(LatticeRefiner(), batches=(5,), verified=5, fallback=0)
"""Five candidates and no more."""

SEVEN = [Phase.APPROACH, Phase.GRASP, Phase.LIFT, Phase.TRANSFER, Phase.LOWER, Phase.RELEASE, Phase.RETREAT]


def test_a_motion_has_all_its_phases_from_home_to_home(motion, bottle_plan):
    phases = [segment.phase for segment in motion.segments]
    assert phases == [Phase.REACH, *SEVEN] * len(bottle_plan.transitions) + [Phase.RETURN]
    home = bottle_plan.problem.workcell.robot.home
    assert np.array_equal(motion.segments[0].trajectory.positions[0], home)
    assert np.array_equal(motion.segments[-1].trajectory.positions[-1], home)
    assert motion.duration == pytest.approx(motion.starts[-1] + motion.segments[-1].trajectory.duration)


def test_the_same_seed_gives_the_same_motion(motion, bottle_plan):
    again = plan_motion(bottle_plan)
    assert len(again.segments) == len(motion.segments)
    for a, b in zip(again.segments, motion.segments, strict=True):
        assert np.array_equal(a.trajectory.positions, b.trajectory.positions)
        assert np.array_equal(a.trajectory.times, b.trajectory.times)


def test_without_a_home_it_begins_with_the_approach_and_ends_with_the_retreat(bottle_plan):
    motion = plan_motion(bottle_plan, MotionOptions(home=None, velocity=0.5, acceleration=[2, 2, 3, 3, 4, 4]))
    phases = [segment.phase for segment in motion.segments]
    assert phases == [*SEVEN, Phase.REACH, *SEVEN]
    assert np.allclose(motion.velocity_limits, bottle_plan.problem.workcell.robot.velocity_limits / 2)
    found = motion_findings(motion)
    assert found.problems == [] and found.collisions == 0


def test_jerk_is_limited_where_that_is_asked_for(motion, bottle_plan):
    limits = np.array([60.0, 60, 80, 80, 100, 100])
    slow = plan_motion(bottle_plan, MotionOptions(jerk=limits))
    assert np.array_equal(slow.jerk_limits, limits) and motion.duration < slow.duration < 1.5 * motion.duration
    found = motion_findings(slow)
    assert found.problems == [] and 0.9 < found.jerk <= 1.001 and found.jump < 1e-4


@pytest.mark.parametrize("jerk", [0.0, -1.0, np.nan, [1.0, 2.0], "fast", 1e9])
def test_a_jerk_out_of_range_is_refused(bottle_plan, jerk):
    with pytest.raises(OptionError, match="jerk"):
        plan_motion(bottle_plan, MotionOptions(jerk=jerk))


def test_an_unsolved_plan_has_no_motion(bottle_plan):
    motion = plan_motion(replace(bottle_plan, status=Status.NOT_FOUND, transitions=()))
    assert motion.status is MotionStatus.NO_PLAN and motion.segments == ()


def test_a_home_that_collides_is_refused(bottle_plan):
    transition = bottle_plan.transitions[0]
    motion = plan_motion(bottle_plan, MotionOptions(home=transition.q_pick[0]))  # the jaw would close on the object
    assert motion.status is MotionStatus.HOME_BLOCKED and "start" in motion.reason


def test_blocked_phases_are_named(bottle_plan, monkeypatch):
    monkeypatch.setattr(Connector, "straight", lambda *_: None)
    monkeypatch.setattr(Connector, "around", lambda *_: None)
    one = bottle_plan.transitions[0]
    first = replace(one, **{n: getattr(one, n)[:1] for n in ("grasp_ids", "q_pick", "q_place", "clearance")})
    motion = plan_motion(replace(bottle_plan, transitions=(first, *bottle_plan.transitions[1:])))
    assert motion.status is MotionStatus.NO_MOTION and motion.segments == ()
    assert "transition 0" in motion.reason and "transfer" in motion.reason


def test_other_arm_configurations_are_tried(bottle_plan):
    """A plan whose configurations do not hold the grasp is not believed, but its grasps may still be held."""
    wrong = tuple(replace(t, q_pick=t.q_pick + 0.01) for t in bottle_plan.transitions)
    motion = plan_motion(replace(bottle_plan, transitions=wrong))
    assert motion.solved
    assert motion_findings(motion).problems == []


def test_an_obstacle_that_appears_after_the_plan_is_not_run_into(bottle_plan):
    problem = bottle_plan.problem
    over = bottle_plan.poses[0][:3, 3] + [0.0, 0.0, 0.35]
    lid = Box("lid", np.array([0.5, 0.5, 0.02]), translation(*over))
    problem = replace(problem, workcell=replace(problem.workcell, obstacles=(lid,)))
    motion = plan_motion(replace(bottle_plan, problem=problem), MotionOptions(home=None, candidates=4, iterations=20))
    assert not motion.solved or motion_findings(motion).problems == []


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"velocity": 0.0}, "velocity"),
        ({"velocity": 1e-320}, "velocity"),
        ({"velocity": 1.5}, "velocity"),
        ({"distances": ()}, "distances"),
        ({"distances": (2.0,)}, "distances"),
        ({"candidates": 0}, "candidates"),
        ({"iterations": 1.5}, "iterations"),
        ({"jaw_time": 0.0}, "jaw_time"),
        ({"seed": -1}, "seed"),
        ({"acceleration": -1.0}, "acceleration"),
        ({"acceleration": 1e-320}, "acceleration"),
        ({"acceleration": np.inf}, "acceleration"),
        ({"acceleration": [1.0, 2.0]}, "acceleration"),
        ({"home": "bed"}, "home"),
        ({"home": [0.0, 1.0]}, "home"),
        ({"home": [9.0] * 6}, "home"),
    ],
)
def test_options_out_of_range_are_refused(bottle_plan, options, named):
    with pytest.raises(OptionError, match=named):
        plan_motion(bottle_plan, MotionOptions(**options))


def test_the_search_goes_on_with_the_next_candidate(bottle_plan):
    shown = []

    def third(plan):
        shown.append(plan)
        return len(shown) == 3

    start, goal = bottle_plan.poses[[0, -1]]
    plan = solve_sequence(bottle_plan.problem, start, goal, accept=third)
    assert plan is shown[2] and plan.solved
    assert np.allclose(shown[0].poses, bottle_plan.poses, atol=1e-3)
    assert not np.allclose(shown[2].poses, shown[0].poses, atol=1e-3)
    assert not np.allclose(shown[1].poses, shown[0].poses, atol=1e-3)


def test_a_search_without_acceptable_plan_ends(bottle_plan):
    start, goal = bottle_plan.poses[[0, -1]]
    plan = solve_sequence(bottle_plan.problem, start, goal, FEW, accept=lambda _: False, max_regrasps=1)
    assert plan.status is Status.NOT_FOUND


def test_poses_and_motion_together(bottle_plan, monkeypatch):
    tried = []

    def second_only(plan, options):
        tried.append(plan)
        found = plan_motion(plan, options)
        if len(tried) > 1:
            return found
        return replace(found, status=MotionStatus.NO_MOTION, reason="too lazy", segments=())

    monkeypatch.setattr(planner, "plan_motion", second_only)
    start, goal = bottle_plan.poses[[0, -1]]
    motion = plan_with_motion(bottle_plan.problem, start, goal)
    assert motion.solved and len(tried) == 2
    assert np.array_equal(motion.plan.poses, tried[1].poses)


def test_together_says_what_was_in_the_way(bottle_plan, monkeypatch):
    def never(plan, options):
        found = plan_motion(replace(plan, status=Status.NOT_FOUND), options)
        return replace(found, status=MotionStatus.NO_MOTION, reason=f"cost {plan.cost:.3f}", plan=plan)

    monkeypatch.setattr(planner, "plan_motion", never)
    start, goal = bottle_plan.poses[[0, -1]]
    motion = plan_with_motion(bottle_plan.problem, start, goal, refiner=FEW, max_regrasps=1)
    assert motion.status is MotionStatus.NO_MOTION
    assert f"cost {motion.plan.cost:.3f}" in motion.reason and "plans allows a motion" in motion.reason


def test_together_without_any_plan(bottle_plan):
    start, goal = bottle_plan.poses[[0, -1]]
    motion = plan_with_motion(bottle_plan.problem, start, goal, max_regrasps=0)
    assert motion.status is MotionStatus.NO_PLAN and "not_found" in motion.reason


def test_lines_are_tilted_where_no_grasp_can_be_lifted_straight(bottle_plan, monkeypatch):
    """Vertical lines are refused, as if the arm could not reach higher there."""
    original = connections.line

    def no_vertical(robot, q, direction, length):
        return None if abs(direction[2]) > 0.99 else original(robot, q, direction, length)

    monkeypatch.setattr(connections, "line", no_vertical)
    options = MotionOptions(home=None, candidates=6)
    motion = plan_motion(bottle_plan, options)
    assert motion.solved, motion.reason
    found = motion_findings(motion)
    assert found.problems == [] and found.collisions == 0
    forward = bottle_plan.problem.workcell.robot.forward
    for segment in motion.segments:
        if segment.phase is Phase.LIFT:
            way = np.diff([forward(q)[:3, 3] for q in segment.trajectory.positions[[0, -1]]], axis=0)[0]
            assert 0.2 < way[2] / np.linalg.norm(way) < 0.99


def test_only_lines_that_cannot_be_straight_are_tilted(bottle_plan, monkeypatch):
    """Vertical lines are refused where the first transition picks, and nowhere else."""
    original = connections.line
    forward = bottle_plan.problem.workcell.robot.forward
    picks = np.array([forward(q)[:3, 3] for q in bottle_plan.transitions[0].q_pick])

    def no_lift(robot, q, direction, length):
        at_pick = np.linalg.norm(picks - robot.forward(q)[:3, 3], axis=1).min() < 1e-4
        return None if at_pick and direction[2] > 0.99 else original(robot, q, direction, length)

    monkeypatch.setattr(connections, "line", no_lift)
    motion = plan_motion(bottle_plan, MotionOptions(home=None, candidates=6, jaw_time=1.5, optimise=False))
    assert motion.solved, motion.reason
    assert {s.trajectory.duration for s in motion.segments if s.phase in (Phase.GRASP, Phase.RELEASE)} == {1.5}

    def rise(phase):
        (q,) = (s.trajectory.positions for s in motion.segments if s.phase is phase and s.transition == 0)
        way = forward(q[-1])[:3, 3] - forward(q[0])[:3, 3]
        return abs(way[2]) / np.linalg.norm(way)

    assert rise(Phase.LIFT) < 0.99
    assert rise(Phase.LOWER) > 0.9999


def test_every_lift_rises(bottle_plan, monkeypatch):
    asked = []

    def nowhere(connector, setting, q, directions):
        asked.append(directions)

    monkeypatch.setattr(Connector, "away", nowhere)
    motion = plan_motion(bottle_plan, MotionOptions(candidates=2))
    assert motion.status is MotionStatus.NO_MOTION and "lift" in motion.reason
    assert {len(directions) for directions in asked} in ({1, 4}, {1, 5}, {1, 4, 5})
    for directions in asked:
        assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
        assert (directions[:, 2] > 0.2).all()
