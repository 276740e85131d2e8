"""From a plan to what a robot executes: the joint problem, free grasps, and joint trajectories."""

from regrasp_opt.motion.free_grasps.search import FreeGraspOptions, solve_with_free_grasps
from regrasp_opt.motion.motion_data import MotionStatus, Phase, Segment
from regrasp_opt.motion.refinement.measures import JointMeasures, MeasureBounds
from regrasp_opt.motion.refinement.refine import JointResult, refine_plan
from regrasp_opt.motion.refinement.search import SearchOptions
from regrasp_opt.motion.trajectory.jaw_events import JawEvent, Squeeze
from regrasp_opt.motion.trajectory.motion_plan import MotionPlan
from regrasp_opt.motion.trajectory.options import MotionOptions
from regrasp_opt.motion.trajectory.planner import plan_motion, plan_with_motion
from regrasp_opt.motion.trajectory.trajectory import Trajectory

Bounds = MeasureBounds  # its name until 0.1; goes with 0.3

__all__ = [
    "FreeGraspOptions",
    "JawEvent",
    "JointMeasures",
    "JointResult",
    "MeasureBounds",
    "MotionOptions",
    "MotionPlan",
    "MotionStatus",
    "Phase",
    "SearchOptions",
    "Segment",
    "Squeeze",
    "Trajectory",
    "plan_motion",
    "plan_with_motion",
    "refine_plan",
    "solve_with_free_grasps",
]
