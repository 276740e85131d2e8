"""Feasibility of one (pose, grasp) pair as a plain loop: every branch, every pair of bodies, one `coal.collide` each.

It shares inverse kinematics and shapes with the package, but none of its collision code.
"""

import coal
import numpy as np

from regrasp_opt.shapes import Box, Cylinder


def geometry(shape):
    if isinstance(shape, Box):
        return coal.Box(*map(float, shape.size))
    if isinstance(shape, Cylinder):
        return coal.Cylinder(float(shape.radius), float(shape.length))
    return triangles(shape.vertices, shape.faces)


def triangles(vertices, faces):
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(np.array(vertices))
    mesh.addTriangles(np.array(faces))
    mesh.endModel()
    return mesh


def touches(a, b, margin):
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.security_margin = margin
    (shape_a, T_a), (shape_b, T_b) = a, b
    return bool(coal.collide(shape_a, coal.Transform3s(T_a[:3, :3], T_a[:3, 3]),
                             shape_b, coal.Transform3s(T_b[:3, :3], T_b[:3, 3]), request, result))  # fmt: skip


def gap(a, b):
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    (shape_a, T_a), (shape_b, T_b) = a, b
    return float(coal.distance(shape_a, coal.Transform3s(T_a[:3, :3], T_a[:3, 3]),
                               shape_b, coal.Transform3s(T_b[:3, :3], T_b[:3, 3]), request, result))  # fmt: skip


class PlainCheck:
    """The bodies of one object, workcell and grasp set."""

    def __init__(self, model, cell, grasps):
        self.cell, self.grasps = cell, grasps
        self.object = triangles(model.vertices, model.faces)
        self.table = (geometry(cell.table.shape), cell.table.shape.pose)
        self.obstacles = [(geometry(shape), shape.pose) for shape in cell.obstacles]
        self.body = [(geometry(shape), shape.pose) for shape in cell.end_effector.body]

    def gripper(self, T_world_flange, grasp_id):
        """Return what is mounted on the flange; a finger covers all openings from the grasp's to the approach's."""
        tool, width = self.cell.end_effector, float(self.grasps.width[grasp_id])
        boxes = [(shape, T_world_flange @ pose) for shape, pose in self.body]
        for finger in tool.finger:
            x, y, z = finger.size
            for side in (1.0, -1.0):
                pose = np.eye(4)
                inner = width / 2 + finger.pose[1, 3] - y / 2
                pose[:3, 3] = finger.pose[0, 3], side * (inner + (y + tool.pre_opening) / 2), finger.pose[2, 3]
                boxes.append((coal.Box(x, y + tool.pre_opening, z), T_world_flange @ pose))
        return boxes

    def bodies(self, q, grasp_id):
        """Return the arm's bodies, the joint that each moves with (0 for the base), and the gripper's bodies."""
        robot, cell = self.cell.robot, self.cell
        frames = cell.T_world_base @ np.concatenate([np.eye(4)[None], robot.link_transforms(q)])
        items = list(robot.collision.geometryObjects)
        arm = [(item.geometry, frames[item.parentJoint] @ item.placement.homogeneous) for item in items]
        gripper = self.gripper(cell.T_world_base @ robot.forward(q), grasp_id)
        return arm, [item.parentJoint for item in items], gripper

    def outer_pairs(self, q, T, grasp_id):
        """Yield (body, body, least distance) for arm and gripper against what is around them."""
        arm, joint, gripper = self.bodies(q, grasp_id)
        for body, j in zip(arm, joint, strict=True):
            if j > 0:
                for other in (self.table, (self.object, T), *self.obstacles):
                    yield body, other, self.cell.clearance.arm
        for tool in gripper:
            for other in (self.table, *self.obstacles):
                yield tool, other, self.cell.clearance.gripper

    def pairs(self, q, T, grasp_id):
        """Yield (body, body, least distance) for everything that must not touch at configuration `q`."""
        arm, joint, gripper = self.bodies(q, grasp_id)
        margins = self.cell.clearance
        yield from self.outer_pairs(q, T, grasp_id)
        for other in (*self.obstacles, *(body for body, j in zip(arm, joint, strict=True) if j == 0)):
            yield (self.object, T), other, margins.gripper
        for body, j in zip(arm, joint, strict=True):
            if j < self.cell.robot.dof:
                for tool in gripper:
                    yield tool, body, margins.self_collision
        for i, body in enumerate(arm):
            for k in range(i):
                if abs(joint[i] - joint[k]) > 1:
                    yield body, arm[k], margins.self_collision

    def clearance(self, q, T, grasp_id):
        """Return the least distance between arm or gripper and what is around them [m]."""
        return min(gap(a, b) for a, b, _ in self.outer_pairs(q, T, grasp_id))

    def free(self, q, T, grasp_id):
        return not any(touches(a, b, margin) for a, b, margin in self.pairs(q, T, grasp_id))

    def feasible(self, T, grasp_id):
        tool, robot = self.cell.end_effector, self.cell.robot
        T_flange_tcp = np.eye(4)
        T_flange_tcp[2, 3] = tool.tcp_offset
        T_world_flange = T @ self.grasps.T_object_tcp[grasp_id] @ np.linalg.inv(T_flange_tcp)
        branches = robot.solve_ik(np.linalg.inv(self.cell.T_world_base) @ T_world_flange).q
        return any(self.free(q, T, grasp_id) for q in branches)
