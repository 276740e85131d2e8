"""Shapes and meshes as Coal geometries."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.shapes import Box, Cylinder, Shape
from regrasp_opt.workcell import Workcell


def mesh_geometry(vertices: FloatArray, faces: IntArray) -> Any:
    """Return a triangle mesh as a Coal bounding-volume hierarchy, concave parts included."""
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(np.asarray(vertices, dtype=np.float64)))
    triangles.extend([coal.Triangle(int(a), int(b), int(c)) for a, b, c in faces])
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(triangles), len(points))
    model.addSubModel(points, triangles)
    model.endModel()
    return model


def shape_geometry(shape: Shape) -> Any:
    """Return `shape` as a Coal geometry; its pose stays with the caller."""
    if isinstance(shape, Box):
        return coal.Box(*[float(s) for s in shape.size])
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.length)
    return mesh_geometry(shape.vertices, shape.faces)


def static_bodies(workcell: Workcell) -> list[tuple[Any, str]]:
    """Return what stands fixed besides the table, as Coal collision objects in the world, with what to call each."""
    bodies = []
    for shape in workcell.obstacles:
        pose = coal.Transform3s(shape.pose[:3, :3], shape.pose[:3, 3])
        bodies.append((coal.CollisionObject(shape_geometry(shape), pose), f"the obstacle '{shape.name}'"))
    for item in workcell.robot.collision.geometryObjects:
        if item.parentJoint == 0:
            T = workcell.T_world_base @ item.placement.homogeneous
            pose = coal.Transform3s(T[:3, :3], T[:3, 3])
            bodies.append((coal.CollisionObject(item.geometry, pose), "the robot's base"))
    return bodies
