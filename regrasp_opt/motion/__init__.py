"""From a plan to what a robot executes: the joint problem and free grasps."""

from regrasp_opt.motion.free_grasps import FreeGraspOptions, solve_with_free_grasps
from regrasp_opt.motion.joint_measures import Bounds, JointMeasures
from regrasp_opt.motion.joint_refine import JointResult, refine_plan
from regrasp_opt.motion.joint_search import SearchOptions

__all__ = [
    "Bounds",
    "FreeGraspOptions",
    "JointMeasures",
    "JointResult",
    "SearchOptions",
    "refine_plan",
    "solve_with_free_grasps",
]
