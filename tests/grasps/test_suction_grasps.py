from __future__ import annotations

import numpy as np
import pytest
import trimesh
from trimesh.transformations import translation_matrix

from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.errors import GraspError
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.grasps.suction import NO_SEAL, seal_grades
from regrasp_opt.grasps.surface import make_surface
from regrasp_opt.objects import ObjectModel, load_object

THICKNESS, SIDE, HOLE = 0.01, 0.16, 0.004


def plate(hole_depth: float = 0.0) -> ObjectModel:
    mesh = trimesh.creation.box(extents=(SIDE, SIDE, THICKNESS))
    if hole_depth:
        drill = trimesh.creation.cylinder(radius=HOLE, height=0.1, sections=24)
        drill.apply_transform(translation_matrix([0, 0, 0.05 + THICKNESS / 2 - hole_depth]))
        mesh = trimesh.boolean.difference([mesh, drill], engine="manifold")
    return ObjectModel("plate", mesh, ())


def grade_at(model: ObjectModel, x: float, y: float, radius: float) -> int:
    top = np.array([[x, y, THICKNESS / 2]])
    return int(seal_grades(make_surface(model.mesh), top, np.array([[0.0, 0.0, -1.0]]), radius)[1][0])


@pytest.mark.parametrize("cup", ["s1", "s2", "s3"])
@pytest.mark.parametrize("hole_depth", [0.002, 0.02])
def test_holes_and_edges_are_kept_clear_of(cup: str, hole_depth: float) -> None:
    tool = load_end_effector(cup)
    grasps = sample_grasps(plate(hole_depth), tool, 60, seed=0)
    position, approach = grasps.T_object_tcp[:, :3, 3], grasps.T_object_tcp[:, :3, 2]
    np.testing.assert_allclose(np.abs(approach[:, 2]), 1.0)
    np.testing.assert_allclose(position[:, 2], -approach[:, 2] * THICKNESS / 2, atol=1e-9)
    assert np.abs(position[:, :2]).max() <= SIDE / 2 - tool.cup_radius + 1e-9
    drilled = (approach[:, 2] < 0) | (hole_depth > THICKNESS)
    clear = np.linalg.norm(position[:, :2], axis=1) >= tool.cup_radius + 0.98 * HOLE
    assert drilled.any() and clear[drilled].all()
    assert (grasps.width == 0).all() and grasps.kind == "suction"


def test_the_seal_ends_where_the_rim_meets_an_edge_or_a_hole() -> None:
    radius = 0.0125
    assert grade_at(plate(0.02), 0.05, 0.0, radius) == 0
    assert grade_at(plate(0.02), SIDE / 2 - radius + 1e-4, 0.0, radius) == NO_SEAL
    assert grade_at(plate(0.02), SIDE / 2 - radius - 1e-4, 0.0, radius) == 0
    assert grade_at(plate(0.02), 0.0, 0.0, radius) == NO_SEAL
    assert grade_at(plate(0.02), radius + HOLE - 2e-4, 0.0, radius) == NO_SEAL
    assert grade_at(plate(0.02), radius + HOLE + 1e-4, 0.0, radius) == 0
    assert grade_at(plate(0.0), 0.0, 0.0, radius) == 0


def test_a_small_hole_between_the_rays_is_found() -> None:
    mesh = trimesh.creation.box(extents=(SIDE, SIDE, THICKNESS))
    drill = trimesh.creation.cylinder(radius=0.0008, height=0.1, sections=12)
    drill.apply_transform(translation_matrix([0.0046, 0.0021, 0.0]))
    drilled = ObjectModel("plate", trimesh.boolean.difference([mesh, drill], engine="manifold"), ())
    assert grade_at(drilled, 0.0, 0.0, 0.015) == NO_SEAL


def test_stronger_curvature_has_a_worse_grade() -> None:
    grades = []
    for radius in (0.2, 0.04, 0.022, 0.012):
        ball = make_surface(trimesh.creation.icosphere(subdivisions=4, radius=radius))
        face = 100
        center, normal = ball.triangles[face].mean(axis=0), ball.normals[face]
        grades.append(int(seal_grades(ball, center[None], -normal[None], 0.01)[1][0]))
    assert grades == [0, 1, 2, NO_SEAL]


def test_no_cup_seals_on_a_small_ball() -> None:
    ball = ObjectModel("ball", trimesh.creation.icosphere(subdivisions=3, radius=0.012), ())
    with pytest.raises(GraspError, match="'s1' fits object 'ball'"):
        sample_grasps(ball, load_end_effector("s1"))


def test_a_flat_object_gets_only_the_best_seals() -> None:
    model = load_object("bottle")
    grasps = sample_grasps(model, load_end_effector("s2"), 100, seed=0)
    _, grade = seal_grades(
        make_surface(model.mesh), grasps.T_object_tcp[:, :3, 3], grasps.T_object_tcp[:, :3, 2], 0.0125
    )
    assert len(grasps) == 100 and (grade == 0).all()


@pytest.mark.parametrize("name", ["mug", "figurine"])
def test_curved_objects_are_held_too(name: str) -> None:
    grasps = sample_grasps(load_object(name), load_end_effector("s3"), 50, seed=0)
    again = sample_grasps(load_object(name), load_end_effector("s3"), 50, seed=0)
    assert len(grasps) == 50 and grasps.fingerprint() == again.fingerprint()
