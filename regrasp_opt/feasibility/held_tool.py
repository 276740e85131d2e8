"""Grasps that put what is fixed to the tool into the object, wherever the object is: the palm and the wrist."""

from __future__ import annotations

import coal
import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.feasibility.tabletop import wrist_bodies
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel
from regrasp_opt.scene import Workcell


def wrist_in_object(workcell: Workcell, body: ObjectModel, grasps: GraspSet) -> BoolArray:
    """Return the grasps (G,) at which a body of the wrist is nearer to the object than the arm's clearance.

    These bodies stand still in the flange's frame, or are round about the last joint's axis, so that neither the
    object's pose nor the arm's configuration matters. The sampler keeps palm and fingers clear by itself.
    """
    mesh = coal.CollisionObject(body.solid.geometry)
    request, found = coal.CollisionRequest(), np.zeros(len(grasps), dtype=bool)
    request.security_margin = workcell.clearance.arm
    T_object_flange = grasps.T_object_tcp @ workcell.arm.end_effector.T_tcp_flange
    for geometry, T in wrist_bodies(workcell.arm.robot):
        for g in np.flatnonzero(~found):
            item = coal.CollisionObject(geometry, _transform(T_object_flange[g] @ T))
            found[g] = bool(coal.collide(mesh, item, request, coal.CollisionResult()))
    return found


def _transform(T: FloatArray) -> coal.Transform3s:
    return coal.Transform3s(T[:3, :3], T[:3, 3])
