"""Motions out of a shelf: the open jaw and the object leave the gap between two boards."""

from pathlib import Path

import numpy as np
from verifying import motion_findings

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.motion import Phase, plan_motion
from regrasp_opt.planning.pose_text import parse_pose

SHELF = Path(__file__).parents[2] / "docs" / "scenes" / "shelf.toml"


def test_a_jaw_that_must_not_back_out_straight_leaves_a_shelf_at_a_slant():
    """Straight back along its axis, or at 45 degrees, every grasp of this mug would meet one of the boards."""
    problem = RegraspProblem.load("mug", SHELF)
    ends = [parse_pose(text, "end", problem) for text in ("lower/1:0.433,0.444,115.7", "side/1:-0.476,0.325,115.3")]
    plan = solve_sequence(problem, *ends)
    motion = plan_motion(plan)
    assert plan.num_regrasps == 0 and motion.solved, motion.reason
    assert motion_findings(motion, step=5e-3, turn=np.deg2rad(2.0)).problems == []
    approach = next(s for s in motion.segments if s.phase is Phase.APPROACH).trajectory.positions
    before, after = (problem.workcell.robot.forward(q) for q in (approach[0], approach[-1]))
    way = after[:3, 3] - before[:3, 3]
    assert 15.0 < np.degrees(np.arccos(way @ after[:3, 2] / np.linalg.norm(way))) < 30.0
