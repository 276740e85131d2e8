"""From a plan to what a robot executes: the joint problem and free grasps."""

from regrasp_opt.motion.joint_measures import Bounds, JointMeasures
from regrasp_opt.motion.joint_refine import JointResult, refine_plan
from regrasp_opt.motion.joint_search import SearchOptions

__all__ = ["Bounds", "JointMeasures", "JointResult", "SearchOptions", "refine_plan"]
