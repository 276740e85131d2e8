"""Grasps: antipodal and suction sampling on an object, and the sets that everything downstream indexes."""

from regrasp_opt.grasps.clearance import BODY_CLEARANCE, CONTACT_TOLERANCE, gripper_free
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.grasps.holding import Failure, hold_failures, rejected_grasps
from regrasp_opt.grasps.sampling import sample_grasps

__all__ = [
    "BODY_CLEARANCE",
    "CONTACT_TOLERANCE",
    "Failure",
    "GraspSet",
    "gripper_free",
    "hold_failures",
    "rejected_grasps",
    "sample_grasps",
]
