"""The collision scene of one object in one workcell: robot, gripper, object, table, obstacles in one model.

The gripper's fingers are boxes swept from the grasp width to the width at which the gripper approaches, so one test
covers every opening between the two. What touches by design is not tested: fingers and cup against the object (the
grasp sampler has proved them free but for the contact), the object against the table it stands on, what stands still
against each other; for the robot's own bodies see `regrasp_opt.scene.pairs`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.geometry.shapes import mesh_geometry, shape_geometry
from regrasp_opt.geometry.solids import Containment, overlap
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel
from regrasp_opt.robots.queries import settle_queries
from regrasp_opt.scene import Workcell
from regrasp_opt.scene.pairs import arm_pairs

_WORLD = 0


class CollisionScene:
    """A Pinocchio geometry model with everything that can collide, and the two things that move by hand.

    Joint configurations are (dof,) in the order of the robot; object poses are (4, 4) T_world_object.
    """

    def __init__(self, model: ObjectModel, workcell: Workcell, grasps: GraspSet) -> None:
        robot, effector = workcell.arm.robot, workcell.arm.end_effector
        self.model = robot.model
        self.geometry = robot.collision.copy()
        self._T_base_world = pin.SE3(workcell.arm.T_base_world)
        moving = [i for i in range(self.geometry.ngeoms) if self._joint(i) != _WORLD]

        tip = robot.model.frames[robot.model.getFrameId(robot.tip_frame)]
        self._tip_joint, self._T_joint_tip = tip.parentJoint, tip.placement
        body = [self._attach(shape_geometry(s), f"gripper/{s.name}", s.pose) for s in effector.body]
        swept = effector.pre_opening
        boxes = [effector.finger_boxes(float(w), swept) for w in grasps.width]
        shapes = boxes[0] if boxes else ()
        self.fingers = [self._attach(shape_geometry(s), f"gripper/{s.name}", s.pose) for s in shapes]
        self._finger_poses = [[self._T_joint_tip * pin.SE3(box.pose) for box in per_grasp] for per_grasp in boxes]

        self.object = self._fix(mesh_geometry(model.vertices, model.faces), "object", np.eye(4))
        self.table = self._fix(shape_geometry(workcell.table.shape), "table", workcell.table.shape.pose)
        self.obstacles = [self._fix(shape_geometry(s), f"obstacle/{s.name}", s.pose) for s in workcell.obstacles]

        gripper = self.gripper = [*body, *self.fingers]
        clearance = workcell.clearance
        pairs: list[tuple[int, int, float]] = []
        pairs += [(i, self.table, clearance.gripper) for i in gripper]
        pairs += [(i, self.table, clearance.arm) for i in reversed(moving)]
        pairs += [(i, self.object, clearance.arm) for i in reversed(moving)]
        pairs += [(i, j, clearance.gripper) for i in gripper for j in self.obstacles]
        pairs += [(i, j, clearance.arm) for i in reversed(moving) for j in self.obstacles]
        near = arm_pairs(workcell)
        pairs += [(i, j, margin) for i in gripper for j, margin in near.tool]
        pairs += near.links
        self._robot, self._pairs = robot, [(i, j) for i, j, _ in pairs]
        for i, j in self._pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.margins = np.array([margin for _, _, margin in pairs])
        self.data, self.geometry_data = self.model.createData(), self.geometry.createData()
        settle_queries(self.geometry_data, self.margins)
        # bounding boxes first, each grown by the margins: exact, and three to four times faster than all pairs
        self._boxes_first = pin.BroadPhaseManager_NaiveCollisionManager(self.model, self.geometry, self.geometry_data)
        self._inside = Containment(self.model, self.data, self.geometry, [(i, j) for i, j, _ in pairs])
        self._placed = b""
        surroundings = {self.table, self.object, *self.obstacles, *robot.obstacles}
        self._measured = np.array([(i, j, k) for k, (i, j, _) in enumerate(pairs) if j in surroundings])
        self._centers, self._radii = self._bounding_spheres()

    def _joint(self, index: int) -> int:
        return int(self.geometry.geometryObjects[index].parentJoint)

    def _bounding_spheres(self) -> tuple[list[FloatArray], FloatArray]:
        """Return a sphere around each body, in its own frame: centres and radii [m]."""
        for item in self.geometry.geometryObjects:
            item.geometry.computeLocalAABB()
        shapes = [item.geometry for item in self.geometry.geometryObjects]
        return [np.array(s.aabb_center) for s in shapes], np.array([s.aabb_radius for s in shapes])

    def _attach(self, geometry: Any, name: str, T_flange_shape: FloatArray) -> int:
        placement = self._T_joint_tip * pin.SE3(np.asarray(T_flange_shape, dtype=np.float64))
        return int(self.geometry.addGeometryObject(pin.GeometryObject(name, self._tip_joint, placement, geometry)))

    def _fix(self, geometry: Any, name: str, T_world_shape: FloatArray) -> int:
        placement = self._T_base_world * pin.SE3(np.asarray(T_world_shape, dtype=np.float64))
        return int(self.geometry.addGeometryObject(pin.GeometryObject(name, _WORLD, placement, geometry)))

    def place_object(self, T: FloatArray) -> None:
        """Put the object at `T` T_world_object."""
        key = np.asarray(T, dtype=np.float64).tobytes()
        if key == self._placed:
            return
        self._placed = key
        self.geometry.geometryObjects[self.object].placement = self._T_base_world * pin.SE3(T)
        self._inside.moved(self.object)

    def set_grasp(self, grasp_id: int) -> None:
        """Open the fingers as grasp `grasp_id` needs them."""
        for index, pose in zip(self.fingers, self._finger_poses[grasp_id], strict=True):
            self.geometry.geometryObjects[index].placement = pose
            self._inside.moved(index)

    def collides(self, q: FloatArray) -> bool:
        """Return whether any pair is nearer than its clearance at configuration `q`, or one body inside the other."""
        touching = pin.computeCollisions(self.model, self.data, self._boxes_first, q, True)
        return bool(touching or self._inside.found(q))

    def collisions(self, q: FloatArray) -> list[tuple[int, int]]:
        """Return the pairs of bodies, by index, that are nearer than their clearance at `q`, or one in the other."""
        pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, False)
        near = {k for k, result in enumerate(self.geometry_data.collisionResults) if result.isCollision()}
        return [self._pairs[k] for k in sorted(near.union(self._inside.found(q)))]

    def name(self, index: int) -> str:
        """Return what to call the body `index`: its link, or its own name."""
        if index < self._robot.collision.ngeoms:
            return self._robot.link_of(index)
        return str(self.geometry.geometryObjects[index].name).rpartition("/")[2]

    def is_obstacle(self, index: int) -> bool:
        """Return whether the body `index` is an obstacle of the workcell, or stands still in the robot's own file."""
        return index in self.obstacles or index in self._robot.obstacles

    def clearance(self, q: FloatArray) -> float:
        """Return the least distance at `q` between arm or gripper and table, obstacles or (arm only) object [m].

        Negative where bodies overlap or one is in the other. Self-collision is tested, but not part of it: neighbouring
        links are always near each other.
        """
        pin.forwardKinematics(self.model, self.data, q)
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.geometry_data)
        poses = self.geometry_data.oMg
        centers = np.array([poses[i].act(c) for i, c in enumerate(self._centers)])
        first, second = self._measured[:, 0], self._measured[:, 1]
        gaps = np.linalg.norm(centers[first] - centers[second], axis=1) - self._radii[first] - self._radii[second]
        solids = self._inside.solids
        inside = set(self._inside.found(q))
        depths = [overlap(solids[i], solids[j]) for i, j, index in self._measured.tolist() if index in inside]
        least = min(depths, default=np.inf)
        for k in np.argsort(gaps):
            if gaps[k] >= least:  # spheres around the bodies are farther apart than the nearest pair so far
                break
            i, j, index = self._measured[k].tolist()
            distance = pin.computeDistance(self.geometry, self.geometry_data, index).min_distance
            if distance <= 0 and solids[i].is_mesh and solids[j].is_mesh:  # Coal says 0 however deep they overlap
                distance = overlap(solids[i], solids[j])
            least = min(least, distance)
        return float(least)
