"""Grasps: antipodal and suction sampling on an object, and the sets that everything downstream indexes."""

from regrasp_opt.grasps.clearance import BODY_CLEARANCE, CONTACT_TOLERANCE, gripper_free
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.grasps.sampling import sample_grasps

__all__ = ["BODY_CLEARANCE", "CONTACT_TOLERANCE", "GraspSet", "gripper_free", "sample_grasps"]
