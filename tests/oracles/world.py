"""All bodies of a cell in one MuJoCo model: where they are at a configuration, and how far apart."""

from __future__ import annotations

import io
from typing import Any, NamedTuple

import mujoco
import numpy as np
import trimesh
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from .files import Cell, Shape
from .solids import Solid

GEOM = mujoco.mjtGeom
DEEP = -1.0
"""What counts as the distance of a body wholly inside another [m]."""
FARTHEST = 100.0
"""What is measured at most [m]."""
SLACK = 1e-4
"""How much nearer than their hulls two bodies may be, through rounding of the hulls [m]."""


class Body(NamedTuple):
    """A body of the model.

    Attributes
    ----------
    name : str
    part : str
        ``arm``, ``fixed`` (turns with no joint, but is not the seat of the first), ``palm``, ``finger`` (as large as
        all the room that it takes while it closes), ``open`` (a finger where it approaches), ``object``, ``support``
        or ``obstacle``.
    link, group
        Link of the robot, and number of the joint that it moves with; 0 for what never moves.
    geom : int
        The body itself where it is convex, else its hull.
    solid : Solid or None
        The triangles of a mesh that is not convex, in the frame given by `T_geom_solid`.
    support : int or None
        Number of the support that it is, or is a body of.
    """

    name: str
    part: str
    link: str
    group: int
    geom: int
    solid: Solid | None = None
    T_geom_solid: Any = None
    support: int | None = None


class World:
    """The bodies of a cell and an object.

    Parameters
    ----------
    cell : Cell
    vertices, faces
        The object's mesh in its frame.
    """

    def __init__(self, cell: Cell, vertices, faces):
        self.cell, self.object_solid = cell, Solid(vertices, faces)
        self._assets: dict[str, bytes] = {}
        self._solids = [Solid(*mesh) for mesh in cell.robot.meshes]
        for n, (points, triangles) in enumerate(cell.robot.meshes):
            self._assets[f"{n}.stl"] = _stl(points, triangles)
        spec = mujoco.MjSpec.from_string(cell.robot.xml, assets=self._assets)
        parts = self._arrange(spec)
        for mesh in spec.meshes:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        self.model = spec.compile()
        self.model.geom_sameframe[:] = 0  # fingers are put elsewhere than where they were compiled
        self.model.opt.ccd_tolerance, self.model.opt.ccd_iterations = 1e-9, 100
        self.data = mujoco.MjData(self.model)
        self.bodies = [self._body(name, *about) for name, about in parts.items()]
        self.index = {body.name: n for n, body in enumerate(self.bodies)}
        self.geoms = np.array([body.geom for body in self.bodies])
        joints = [self.model.joint(name) for name in cell.robot.joints]
        self.qpos = np.array([joint.qposadr[0] for joint in joints])
        self.tip = self.model.body(cell.robot.tip).id
        self.dof = len(joints)
        self._triangles = [self._free_triangle(f"triangle{n}") for n in range(2)]
        self._half = self.model.geom_aabb[:, 3:]
        self._middle = self.model.geom_aabb[:, :3]

    # ---- making the model

    def _arrange(self, spec):
        """Name all geoms and add what is not the robot's; return part, link, group and solid by name."""
        cell, robot, parts = self.cell, self.cell.robot, {}
        for body in list(spec.bodies)[1:]:
            if body.parent.name == "world":
                body.pos, body.quat = cell.T_world_base[:3, 3], _quat(cell.T_world_base)
            for n, geom in enumerate(body.geoms):
                geom.name = f"{body.name}/{n}"
                group = robot.group[body.name]
                part = "fixed" if group == 0 and body.name != robot.seat else "arm"
                solid = self._solids[int(geom.meshname)] if geom.type == GEOM.mjGEOM_MESH else None
                parts[geom.name] = part, body.name, group, solid
        world, tip = spec.worldbody, spec.body(robot.tip)
        for n, support in enumerate(cell.supports):
            for shape in support.bodies:
                self._add(spec, world, parts, shape, "support", support=n)
        for shape in cell.obstacles:
            self._add(spec, world, parts, shape, "obstacle")
        for shape in cell.tool.body:
            self._add(spec, tip, parts, Shape(f"gripper {shape.name}", shape.kind, shape.T, shape.size), "palm")
        for n, (low, high) in enumerate(cell.tool.fingers):
            for state in ("finger", "open"):
                for side in "+-":
                    self._add(spec, tip, parts, Shape(f"{state} {n}{side}", "box", np.eye(4), high - low), state)
        mesh = self.object_solid
        shape = Shape("object", "mesh", np.eye(4), None, mesh.vertices, mesh.vertices)
        self._add(spec, world, parts, shape, "object", mesh)
        for n in range(2):
            flat = spec.add_mesh(name=f"triangle{n}", uservert=np.eye(4)[:, :3].ravel())
            flat.userface = [0, 1, 2, 0, 2, 3, 0, 3, 1, 1, 3, 2]
            spec.worldbody.add_geom(name=f"triangle{n}", type=GEOM.mjGEOM_MESH, meshname=f"triangle{n}")
        return parts

    def _add(self, spec, body, parts, shape, part, solid=None, support=None):
        pose = {"name": f"{part}:{shape.name}" if part in ("obstacle", "support") else shape.name}
        pose |= {"pos": shape.T[:3, 3], "quat": _quat(shape.T)}
        if shape.kind == "box":
            body.add_geom(**pose, type=GEOM.mjGEOM_BOX, size=np.asarray(shape.size) / 2)
        elif shape.kind == "cylinder":
            body.add_geom(**pose, type=GEOM.mjGEOM_CYLINDER, size=[shape.size[0], shape.size[1] / 2, 0])
        else:
            solid = solid or Solid(shape.vertices, shape.faces)
            hull = solid.vertices if solid.hull is None else solid.vertices[solid.hull.vertices]
            name = f"mesh of {pose['name']}"
            spec.add_mesh(name=name, uservert=hull.ravel())
            body.add_geom(**pose, type=GEOM.mjGEOM_MESH, meshname=name)
        group = self.cell.robot.group[self.cell.robot.tip] if part in ("palm", "finger", "open") else 0
        parts[pose["name"]] = part, "", group, solid, support

    def _body(self, name, part, link, group, solid, support=None):
        geom = self.model.geom(name).id
        T = None
        if solid is not None:
            mesh = self.model.geom_dataid[geom]
            T = np.linalg.inv(_pose(self.model.mesh_pos[mesh], self.model.mesh_quat[mesh]))
        shown = name.removeprefix("obstacle:").removeprefix("support:")
        return Body(shown, part, link, group, geom, solid, T, support)

    def _free_triangle(self, name):
        """Return the geom of a free triangle, and its corners in the model: three, and one of them again."""
        geom = self.model.geom(name).id
        first = self.model.mesh_vertadr[self.model.geom_dataid[geom]]
        return geom, self.model.mesh_vert[first : first + 4]

    # ---- where bodies are

    def place(self, q, T_object, closed, opened):
        """Put the arm at `q` (dof,), the object at (4, 4) in the world, and the fingers where they hold and approach.

        Returns the tip's pose (4, 4) in the world.
        """
        self.data.qpos[self.qpos] = q
        self._open(closed, opened)
        mujoco.mj_kinematics(self.model, self.data)
        T_world_tip = np.eye(4)
        T_world_tip[:3, :3] = self.data.xmat[self.tip].reshape(3, 3)
        T_world_tip[:3, 3] = self.data.xpos[self.tip]
        if T_object is not None:
            self.put("object", T_object)
        return T_world_tip

    def _open(self, closed, opened):
        for n, (low, high) in enumerate(self.cell.tool.fingers):
            for state, inner, outer in (("finger", closed, opened), ("open", opened, opened)):
                ends = low + np.array([0, inner / 2, 0]), high + np.array([0, outer / 2, 0])
                middle, half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
                for side, sign in (("+", 1.0), ("-", -1.0)):
                    geom = self.geoms[self.index[f"{state} {n}{side}"]]
                    self.model.geom_pos[geom] = middle * [1, sign, 1]
                    self.model.geom_size[geom] = self.model.geom_aabb[geom, 3:] = half

    def put_fingers(self, T_world_tip, opening):
        """Put the fingers that approach where they are at an opening [m] of a hand at (4, 4); return their numbers."""
        self._open(opening, opening)
        numbers = [n for n, body in enumerate(self.bodies) if body.part == "open"]
        for n in numbers:
            geom = self.geoms[n]
            self.data.geom_xpos[geom] = T_world_tip[:3, :3] @ self.model.geom_pos[geom] + T_world_tip[:3, 3]
            self.data.geom_xmat[geom] = T_world_tip[:3, :3].ravel()
        return numbers

    def put(self, name, T):
        """Put the mesh `name` with its own frame at `T` (4, 4) in the world."""
        body = self.bodies[self.index[name]]
        T = T @ np.linalg.inv(body.T_geom_solid)
        self.data.geom_xpos[body.geom], self.data.geom_xmat[body.geom] = T[:3, 3], T[:3, :3].ravel()

    def centers(self):
        """Return the middle of each body's bounding ball (bodies, 3) in the world."""
        R = self.data.geom_xmat[self.geoms].reshape(-1, 3, 3)
        return self.data.geom_xpos[self.geoms] + np.einsum("gij,gj->gi", R, self._middle[self.geoms])

    def radii(self):
        """Return the radius of each body's bounding ball (bodies,) [m]."""
        return np.linalg.norm(self._half[self.geoms], axis=1)

    # ---- how far apart

    def distance(self, a, b, most, enough=-np.inf):
        """Return the distance of bodies number `a` and `b` [m], negative where they overlap.

        Where it is more than `most`, something between `most` and the distance is returned; where it is less than
        `enough`, something between the distance and that.
        """
        first, second = self.bodies[a], self.bodies[b]
        hulls = self._between(first.geom, second.geom, FARTHEST)
        if _is_hull(first) and _is_hull(second):
            return hulls
        if hulls >= most + SLACK:
            return hulls - SLACK
        if _is_hull(first):
            first, second = second, first
        if _is_hull(second):
            found = self._to_convex(first, second, most, enough)
            if found > 0 and hulls < 0 and self._holds(first, self._center(second)):
                return DEEP
            return found
        found = self._to_solid(first, second, most, enough)
        inside = found > 0 and hulls < 0
        if inside and (self._holds(first, self._point(second)) or self._holds(second, self._point(first))):
            return DEEP
        return found

    def _between(self, a, b, most):
        return mujoco.mj_geomDistance(self.model, self.data, a, b, most, None)

    def _T_geom(self, geom):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.data.geom_xmat[geom].reshape(3, 3), self.data.geom_xpos[geom]
        return T

    def _center(self, body):
        return self.data.geom_xpos[body.geom]

    def _point(self, body):
        T = self._frame(body)
        return T[:3, :3] @ body.solid.corners[0, 0] + T[:3, 3]

    def _holds(self, body, point):
        """Return whether the closed mesh `body` has the world point (3,) inside."""
        if not body.solid.closed:
            return False
        T = self._frame(body)
        return bool(body.solid.winding((T[:3, :3].T @ (point - T[:3, 3]))[None])[0] > 0.5)

    def _frame(self, body):
        """Return the pose (4, 4) in the world of a mesh's own frame."""
        return self._T_geom(body.geom) @ body.T_geom_solid

    def _triangle(self, n, T):
        """Put the free triangle number `n` into a frame (4, 4); return its geom and its corners, to be written to."""
        geom, corners = self._triangles[n]
        self.data.geom_xpos[geom], self.data.geom_xmat[geom] = T[:3, 3], T[:3, :3].ravel()
        return geom, corners

    def _near(self, mesh, geom, T_world_mesh, most):
        """Return rows of the triangles of `mesh` that may be nearer than `most` to the box around a geom, and bounds.

        The bounds are on the distance of each to that box [m].
        """
        solid, T = mesh.solid, np.linalg.inv(self._T_geom(geom)) @ T_world_mesh

        def gap(centers, radii):
            beyond = np.abs(centers @ T[:3, :3].T + T[:3, 3] - self._middle[geom]) - self._half[geom]
            return np.linalg.norm(np.maximum(beyond, 0), axis=1) - radii

        groups = np.flatnonzero(gap(solid.group_center, solid.group_radius) < most)
        rows = np.concatenate([np.arange(0), *(np.arange(solid.groups[g].start, solid.groups[g].stop) for g in groups)])
        least = gap(solid.center[rows], solid.radius[rows])
        return rows[least < most], least[least < most]

    def _to_convex(self, mesh, other, most, enough):
        """Return the least distance of the triangles of `mesh` to a convex body, up to `most`."""
        T = self._frame(mesh)
        rows, least = self._near(mesh, other.geom, T, most)
        triangle, corners = self._triangle(0, T)
        best = most
        for k in np.argsort(least):
            if least[k] > max(best, 0.0) or best < enough:
                break
            corners[:] = mesh.solid.four[rows[k]]
            best = min(best, self._between(triangle, other.geom, max(best, 0.0)))
        return best

    def _to_solid(self, first, second, most, enough):
        """Return the least distance between the triangles of two meshes, up to `most`."""
        T_a, T_b = self._frame(first), self._frame(second)
        most = min(most, self._some_distance(first.solid, T_a, second.solid, T_b))
        rows_a, rows_b = (self._near(m, o.geom, T, most)[0] for m, o, T in ((first, second, T_a), (second, first, T_b)))
        if len(rows_a) == 0 or len(rows_b) == 0:
            return most
        a, b = first.solid, second.solid
        T = np.linalg.inv(T_a) @ T_b
        in_a, there = a.corners[rows_a], b.corners[rows_b] @ T[:3, :3].T + T[:3, 3]
        low_a, high_a, low_b, high_b = in_a.min(axis=1), in_a.max(axis=1), there.min(axis=1), there.max(axis=1)
        pairs = []
        for start in range(0, len(rows_a), 256):
            part = slice(start, start + 256)
            apart = np.maximum(low_a[part, None] - high_b, low_b - high_a[part, None]).max(axis=2)
            i, j = np.nonzero(apart < most)
            pairs.append(np.stack([i + start, j]))
        i, j = np.concatenate(pairs, axis=1)
        gaps = np.maximum(np.maximum(low_a[i] - high_b[j], low_b[j] - high_a[i]), 0)
        least = np.linalg.norm(gaps, axis=1)
        least = np.maximum(least, _beyond(in_a[i], a.normals[rows_a[i]], there[j]))
        least = np.maximum(least, _beyond(there[j], b.normals[rows_b[j]] @ T[:3, :3].T, in_a[i]))
        (one, corners), (other, others) = self._triangle(0, T_a), self._triangle(1, T_b)
        best = most
        near = np.flatnonzero(least < most)
        for k in near[np.argsort(least[near])]:
            if least[k] > max(best, 0.0) or best < enough:
                break
            corners[:], others[:] = a.four[rows_a[i[k]]], b.four[rows_b[j[k]]]
            best = min(best, self._between(one, other, max(best, 0.0)))
        return best

    def _some_distance(self, a, T_a, b, T_b):
        """Return the distance of two triangles that are near each other, or 0 where they overlap."""
        T = np.linalg.inv(T_a) @ T_b
        centers = b.center @ T[:3, :3].T + T[:3, 3]
        groups = b.group_center @ T[:3, :3].T + T[:3, 3]
        m, n = np.unravel_index(cdist(a.group_center, groups).argmin(), (len(a.groups), len(b.groups)))
        rows, others = a.groups[m], b.groups[n]
        apart = cdist(a.center[rows], centers[others])
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        (one, corners), (other, more) = self._triangle(0, T_a), self._triangle(1, T_b)
        corners[:], more[:] = a.four[rows.start + i], b.four[others.start + j]
        return max(self._between(one, other, FARTHEST), 0.0) + 1e-9


def _beyond(corners, normals, others):
    """Return how far `others` (P, 3, 3) are on one side of the planes of `corners` (P, 3, 3), or 0 (P,)."""
    heights = np.einsum("pki,pi->pk", others - corners[:, :1], normals)
    return np.maximum(np.maximum(heights.min(axis=1), -heights.max(axis=1)), 0)


def _is_hull(body):
    return body.solid is None or body.solid.convex


def _quat(T):
    return np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), 1)


def _pose(position, quat):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(np.roll(quat, -1)).as_matrix()
    T[:3, 3] = position
    return T


def _stl(vertices, faces):
    with io.BytesIO() as file:
        trimesh.Trimesh(vertices, faces, process=False).export(file, file_type="stl")
        return file.getvalue()
