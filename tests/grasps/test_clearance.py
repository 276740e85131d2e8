"""The test of a gripper against an object: arrays decide most poses, and never otherwise than Coal."""

from __future__ import annotations

import coal
import numpy as np
import pytest
import trimesh

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.end_effectors import EndEffector, load_end_effector
from regrasp_opt.geometry.shapes import mesh_geometry, shape_geometry
from regrasp_opt.grasps import BODY_CLEARANCE, CONTACT_TOLERANCE
from regrasp_opt.grasps.antipodal import contact_pairs
from regrasp_opt.grasps.candidates import frames_about
from regrasp_opt.grasps.clearance import GripperClearance
from regrasp_opt.grasps.surface import make_surface, sample_points
from regrasp_opt.objects import load_object

MESHES = {
    "mug": lambda: load_object("mug").mesh,
    "figurine": lambda: load_object("figurine").mesh,
    "block": lambda: trimesh.creation.box((0.05, 0.04, 0.12)),
    "slats": lambda: trimesh.util.concatenate([slat(y) for y in (-0.03, 0.0, 0.02)]),
    "far from its origin": lambda: trimesh.creation.capsule(0.06, 0.02).apply_translation((4e4, -3e4, 2e4)),
    "fine ring": lambda: trimesh.creation.torus(0.05, 0.012, major_sections=100, minor_sections=50),
}


def slat(y: float) -> trimesh.Trimesh:
    return trimesh.creation.box((0.08, 0.002, 0.06)).apply_translation((0.0, y, 0.0))


def poses_about(mesh: trimesh.Trimesh, tool: EndEffector, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return frames (N, 4, 4) at contacts, others at points of the surface and in any direction, and widths (N,)."""
    surface = make_surface(mesh)
    middle, closing, width = contact_pairs(surface, tool, 100, rng)
    held = frames_about(middle, closing, 6, rng.normal(size=middle.shape), closing=True)
    points, face = sample_points(surface, 200, rng)
    near = frames_about(
        points + rng.normal(0, 0.02, points.shape), -surface.normals[face], 2, rng.normal(size=points.shape)
    )
    near[:, :3, 3] += rng.uniform(0, 0.2, (len(near), 1)) * near[:, :3, 2]
    return np.concatenate([held, near]), np.concatenate([np.repeat(width, 6), rng.uniform(0, 0.07, len(near))])


def coal_free(mesh: trimesh.Trimesh, tool: EndEffector, T: FloatArray, width: FloatArray | None) -> BoolArray:
    """Return in which poses Coal, asked for each alone, finds the body (no width) or the fingers clear."""
    geometry, free = mesh_geometry(mesh.vertices, mesh.faces), np.ones(len(T), dtype=bool)
    inner = min(CONTACT_TOLERANCE, tool.pre_opening)
    for i, pose in enumerate(T):
        shapes = tool.body
        if width is not None:
            shapes = tool.finger_boxes(width[i] + 2 * inner, swept=tool.pre_opening - inner)
        request = coal.CollisionRequest()
        request.security_margin = BODY_CLEARANCE if width is None and tool.kind == "parallel" else 0.0
        for shape in shapes:
            X = pose @ tool.T_tcp_flange @ shape.pose
            where, result = coal.Transform3s(X[:3, :3], X[:3, 3]), coal.CollisionResult()
            free[i] &= not coal.collide(geometry, coal.Transform3s(), shape_geometry(shape), where, request, result)
    return free


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("gripper", ["w", "r140", "s1"])
def test_arrays_and_coal_agree(name: str, gripper: str) -> None:
    mesh, tool = MESHES[name](), load_end_effector(gripper)
    T, width = poses_about(mesh, load_end_effector("w"), np.random.default_rng(7))
    clearance = GripperClearance(mesh.vertices, mesh.faces, tool)
    body = coal_free(mesh, tool, T, None)
    np.testing.assert_array_equal(clearance.body_free(T), body)
    assert 0 < body.sum() < len(body)
    fingers = coal_free(mesh, tool, T, width)
    np.testing.assert_array_equal(clearance.fingers_free(T, width), fingers)
    assert clearance.may_be_free(T, width)[body & fingers].all()
    assert tool.kind == "suction" or 0 < fingers.sum() < len(fingers)


def test_arrays_decide_most_overlaps() -> None:
    """Which is what they are for: of the poses that Coal refuses, few are left to it."""
    mesh, tool = MESHES["figurine"](), load_end_effector("w")
    T, width = poses_about(mesh, tool, np.random.default_rng(8))
    clearance = GripperClearance(mesh.vertices, mesh.faces, tool)
    blocked = ~(coal_free(mesh, tool, T, None) & coal_free(mesh, tool, T, width))
    assert (~clearance.may_be_free(T, width)[blocked]).mean() > 0.75


def test_the_jaw_opens_no_wider_than_it_must() -> None:
    """At a hollow side: two rods, 1 mm proud of the block between them, keep the pads off the contacts."""
    rods = [trimesh.creation.box((0.004, 0.042, 0.12)).apply_translation((x, 0.0, 0.0)) for x in (-0.01, 0.01)]
    mesh, tool = trimesh.util.concatenate([MESHES["block"](), *rods]), load_end_effector("w")
    down = -np.eye(3)[[2, 2]]
    T = frames_about(np.array([[0.0, 0.0, 0.07], [0.0, 0.0, 0.31]]), np.eye(3)[[1, 1]], 1, down, closing=True)
    clearance = GripperClearance(mesh.vertices, mesh.faces, tool)
    np.testing.assert_allclose(clearance.fitting(T, np.full(2, 0.0395), 0.094), [0.041, 0.0395])
    assert np.isnan(clearance.fitting(T, np.full(2, 0.036), 0.094)).tolist() == [True, False]
    assert np.isnan(clearance.fitting(T, np.full(2, 0.0395), 0.04)).tolist() == [True, False]


def test_no_poses_are_none_that_are_free() -> None:
    mesh = MESHES["block"]()
    clearance = GripperClearance(mesh.vertices, mesh.faces, load_end_effector("w"))
    assert clearance.body_free(np.zeros((0, 4, 4))).shape == (0,)
    assert clearance.fingers_free(np.zeros((0, 4, 4)), np.zeros(0)).shape == (0,)
