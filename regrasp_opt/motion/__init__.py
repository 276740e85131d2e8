"""From a plan to what a robot executes: the joint problem, free grasps, and joint trajectories."""

from regrasp_opt.motion.free_grasps import FreeGraspOptions, solve_with_free_grasps
from regrasp_opt.motion.joint_measures import Bounds, JointMeasures
from regrasp_opt.motion.joint_refine import JointResult, refine_plan
from regrasp_opt.motion.joint_search import SearchOptions
from regrasp_opt.motion.motion_data import MotionStatus, Phase, Segment
from regrasp_opt.motion.options import MotionOptions
from regrasp_opt.motion.plan import MotionPlan
from regrasp_opt.motion.planner import plan_motion
from regrasp_opt.motion.together import plan_with_motion
from regrasp_opt.motion.trajectory import Trajectory

__all__ = [
    "Bounds",
    "FreeGraspOptions",
    "JointMeasures",
    "JointResult",
    "MotionOptions",
    "MotionPlan",
    "MotionStatus",
    "Phase",
    "SearchOptions",
    "Segment",
    "Trajectory",
    "plan_motion",
    "plan_with_motion",
    "refine_plan",
    "solve_with_free_grasps",
]
