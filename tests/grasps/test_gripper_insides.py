"""A gripper that is wholly inside a solid object overlaps it, though it touches no surface."""

import numpy as np
import trimesh

from regrasp_opt.conventions import translation
from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.grasps import GraspSet, gripper_free
from regrasp_opt.objects.model import ObjectModel


def test_a_gripper_inside_the_object_is_not_free():
    block = ObjectModel("block", trimesh.creation.box((0.9, 0.9, 0.9)), ())
    T = np.array([translation(0.0, 0.0, 0.1), translation(0.0, 0.0, 1.2), translation(0.0, 0.0, 0.45)])
    grasps = GraspSet(T, np.full(3, 0.05), "parallel")
    assert gripper_free(grasps, block, load_end_effector("w")).tolist() == [False, True, False]
