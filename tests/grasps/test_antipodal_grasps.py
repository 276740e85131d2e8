from __future__ import annotations

from functools import cache

import coal
import numpy as np
import pytest
import trimesh

from regrasp_opt.conventions import pose_distance
from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.grasps import BODY_CLEARANCE, CONTACT_TOLERANCE, GraspSet, sample_grasps
from regrasp_opt.grasps.antipodal import FRICTION, contact_depths
from regrasp_opt.grasps.clearance import WIDENINGS
from regrasp_opt.grasps.surface import cast_rays, make_surface, sample_points, tangents
from regrasp_opt.objects import ObjectModel, load_object

CASES = [("bottle", "w"), ("mug", "w"), ("mug", "r140"), ("pentagon", "r85"), ("figurine", "w")]


@cache
def sampled(name: str, gripper: str) -> tuple[ObjectModel, GraspSet]:
    model = load_object(name)
    return model, sample_grasps(model, load_end_effector(gripper), 120, seed=3)


def solid(mesh: trimesh.Trimesh, name: str = "part") -> ObjectModel:
    return ObjectModel(name, mesh, ())


def coal_surface(model: ObjectModel) -> coal.BVHModelOBBRSS:
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(model.faces), len(model.vertices))
    for a, b, c in model.vertices[model.faces]:
        surface.addTriangle(a, b, c)
    surface.endModel()
    return surface


def distance_to(surface: coal.BVHModelOBBRSS, box: Box, T_object_flange: np.ndarray) -> float:
    pose = T_object_flange @ box.pose
    placed = coal.Transform3s(pose[:3, :3], pose[:3, 3])
    result = coal.DistanceResult()
    return coal.distance(surface, coal.Transform3s(), coal.Box(*box.size), placed, coal.DistanceRequest(), result)


@pytest.mark.parametrize(("name", "gripper"), CASES)
def test_sets_are_full_and_fit_the_jaw(name: str, gripper: str) -> None:
    tool = load_end_effector(gripper)
    _, grasps = sampled(name, gripper)
    assert len(grasps) == 120 and grasps.kind == "parallel"
    assert grasps.width.min() >= 0.001 and grasps.width.max() <= tool.max_opening - 2 * tool.pre_opening


@pytest.mark.parametrize(("name", "gripper"), CASES)
def test_every_grasp_has_two_contacts_inside_their_friction_cones(name: str, gripper: str) -> None:
    model, grasps = sampled(name, gripper)
    least = 1 / np.hypot(1, FRICTION) - 1e-6
    antipodal = np.zeros(len(grasps), dtype=bool)
    for depth in contact_depths(load_end_effector(gripper)):
        middle = grasps.T_object_tcp[:, :3, 3] + depth * grasps.T_object_tcp[:, :3, 2]
        for widening in WIDENINGS:
            held = np.ones(len(grasps), dtype=bool)
            for side in (-1.0, 1.0):
                outward = side * grasps.T_object_tcp[:, :3, 1]
                points = middle + 0.5 * (grasps.width - widening)[:, None] * outward
                _, gap, triangle = trimesh.proximity.closest_point(model.mesh, points)
                facing = np.einsum("ij,ij->i", model.mesh.face_normals[triangle], outward)
                held &= (gap < 1e-7) & (facing >= least)
            antipodal |= held
    assert antipodal.all()


@pytest.mark.parametrize(("name", "gripper"), CASES)
def test_every_grasp_is_clear_from_closed_to_open(name: str, gripper: str) -> None:
    model, grasps = sampled(name, gripper)
    tool, surface = load_end_effector(gripper), coal_surface(model)
    for T, width in zip(grasps.T_object_tcp, grasps.width, strict=True):
        flange = T @ tool.T_tcp_flange
        for beyond in np.linspace(CONTACT_TOLERANCE, tool.pre_opening, 3):
            for box in tool.finger_boxes(width + 2 * beyond):
                assert distance_to(surface, box, flange) > -1e-9
        for body in tool.body:
            assert isinstance(body, Box)
            assert distance_to(surface, body, flange) >= BODY_CLEARANCE - 1e-5


def test_a_mug_is_held_by_its_wall_and_across() -> None:
    _, grasps = sampled("mug", "w")
    assert (grasps.width < 0.009).any() and (grasps.width > 0.07).any()


def test_grasps_are_spread_over_the_object_and_all_around() -> None:
    model, grasps = sampled("bottle", "w")
    heights = grasps.T_object_tcp[:, 2, 3]
    assert np.histogram(heights, bins=5, range=(0.0, 0.2))[0].min() >= 4
    octants = np.unique(grasps.T_object_tcp[:, :3, 2] > 0, axis=0)
    assert len(octants) == 8
    distance, angle = pose_distance(grasps.T_object_tcp[:, None], grasps.T_object_tcp[None])
    assert ((distance > 1e-3) | (angle > 0.02))[~np.eye(len(grasps), dtype=bool)].all()
    assert model.name == "bottle"


def test_same_seed_same_set_other_seed_other_set() -> None:
    model, gripper = load_object("pentagon"), load_end_effector("w")
    first = sample_grasps(model, gripper, 50, seed=1)
    assert first.fingerprint() == sample_grasps(model, gripper, 50, seed=1).fingerprint()
    assert first.fingerprint() != sample_grasps(model, gripper, 50, seed=2).fingerprint()


@pytest.mark.parametrize("seed", [1, 2])
def test_unseen_grasps_are_disjoint(seed: int) -> None:
    model, gripper = load_object("pentagon"), load_end_effector("w")
    seen = sample_grasps(model, gripper, 100, seed=1)
    unseen = sample_grasps(model, gripper, 100, seed=seed, exclude=seen)
    distance, angle = pose_distance(seen.T_object_tcp[:, None], unseen.T_object_tcp[None])
    assert len(unseen) == 100 and ((distance >= 1e-3) | (angle >= 0.02)).all()


def test_nothing_fits_a_cube_wider_than_the_jaw() -> None:
    with pytest.raises(GraspError, match="'w' fits object 'crate'"):
        sample_grasps(solid(trimesh.creation.box(extents=(0.5, 0.5, 0.5)), "crate"), load_end_effector("w"))


def test_stroke_leaves_room_for_the_approach() -> None:
    gripper = load_end_effector("w")
    with pytest.raises(GraspError):
        sample_grasps(solid(trimesh.creation.box(extents=(0.0945, 0.2, 0.2))), gripper, 20)
    grasps = sample_grasps(solid(trimesh.creation.box(extents=(0.0935, 0.2, 0.2))), gripper, 20)
    np.testing.assert_allclose(grasps.width.min(), 0.0935, atol=1e-9)


def test_count_is_checked() -> None:
    with pytest.raises(OptionError, match="count"):
        sample_grasps(load_object("pentagon"), load_end_effector("w"), 0)


def test_rays_find_the_faces_of_a_turned_box() -> None:
    mesh = trimesh.creation.box(extents=(0.04, 0.06, 0.08))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0.1, 0, 0]))
    surface = make_surface(mesh)
    rng = np.random.default_rng(0)
    points, face = sample_points(surface, 200, rng)
    hits = cast_rays(surface, points, -surface.normals[face])
    through = hits.distance > 1e-6
    order = np.argsort(hits.ray[through], kind="stable")
    np.testing.assert_array_equal(hits.ray[through][order], np.arange(200))
    sides = np.array([0.04, 0.06, 0.08])
    assert (np.abs(hits.distance[through][:, None] - sides).min(axis=1) < 1e-9).all()
    assert len(cast_rays(surface, points[:0], points[:0]).ray) == 0


def test_points_are_spread_by_area() -> None:
    surface = make_surface(trimesh.creation.box(extents=(0.01, 0.1, 0.1)))
    _, face = sample_points(surface, 4000, np.random.default_rng(0))
    large = np.abs(surface.normals[face, 0]) > 0.9
    assert large.mean() == pytest.approx(0.02 / 0.024, abs=0.03)


def test_tangents_complete_a_frame() -> None:
    normals = np.random.default_rng(0).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    u, v = tangents(normals)
    frames = np.stack([u, v, normals], axis=2)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)
