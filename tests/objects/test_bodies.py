"""Meshes as they come: several bodies, surfaces that are not closed, sheets."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from dae_files import collada, triangles
from trimesh.transformations import rotation_matrix, translation_matrix
from trimesh.util import concatenate

from regrasp_opt import RegraspProblem, load_object, solve_sequence
from regrasp_opt.errors import MeshError, OptionError
from regrasp_opt.objects.changes import compare
from regrasp_opt.objects.repair import CELLS, remeshed
from regrasp_opt.planning import RegraspPlan

Maker = Callable[[], trimesh.Trimesh]
SIDE = 0.04


def box(extents=(SIDE, SIDE, SIDE), at=(0, 0, 0)) -> trimesh.Trimesh:
    return trimesh.creation.box(extents, translation_matrix(at))


def can(radius: float, height: float, at=(0, 0, 0)) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, height, sections=40, transform=translation_matrix(at))


def ball(radius: float) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(3, radius)


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.invert()
    return mesh


def cup() -> trimesh.Trimesh:
    """A single sheet: a can without its top."""
    mesh = can(0.03, 0.1)
    mesh.update_faces(mesh.face_normals[:, 2] < 0.5)
    return mesh


def plate() -> trimesh.Trimesh:
    return trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], [[0, 1, 2], [0, 2, 3]])


def handle() -> trimesh.Trimesh:
    ring = trimesh.creation.torus(0.025, 0.005)
    return ring.apply_transform(translation_matrix([0.045, 0, 0]) @ rotation_matrix(np.pi / 2, [1, 0, 0]))


def soup(mesh: trimesh.Trimesh, noise: float = 0.0) -> trimesh.Trimesh:
    """Return the triangles of `mesh` with corners of their own."""
    corners = mesh.triangles.reshape(-1, 3)
    corners = corners + np.random.default_rng(0).uniform(-noise, noise, corners.shape)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)


def carton() -> trimesh.Trimesh:
    return concatenate([box((0.06, 0.06, 0.1)), can(0.012, 0.02, (0, 0, 0.058))])


def wall_in_common() -> trimesh.Trimesh:
    """Two boxes side by side, with the wall between them only once."""
    other = box(at=(SIDE, 0, 0))
    other.update_faces(other.face_normals[:, 0] > -0.5)
    return concatenate([box(), other])


def load(mesh: trimesh.Trimesh, folder: Path, **options) -> trimesh.Trimesh:
    mesh.export(folder / "part.stl")
    return load_object(folder / "part.stl", **options).mesh


CUBE = SIDE**3


@pytest.mark.parametrize(
    ("make", "bodies", "volume", "center"),
    [
        (lambda: concatenate([box(), box(at=(0.06, 0, 0))]), 2, 2 * CUBE, 0.03),
        (lambda: concatenate([box(), box(at=(SIDE, 0, 0))]), 1, 2 * CUBE, SIDE / 2),
        (lambda: concatenate([box(), box(at=(SIDE, SIDE, 0))]), 2, 2 * CUBE, SIDE / 2),
        (lambda: concatenate([box(), box(at=(SIDE / 2, 0, 0))]), 1, 1.5 * CUBE, SIDE / 4),
        (lambda: concatenate([box(), box((SIDE, SIDE / 2, SIDE / 2), (SIDE, 0, 0))]), 1, 1.25 * CUBE, SIDE / 5),
        (lambda: concatenate([ball(0.04), ball(0.02)]), 1, ball(0.04).volume, 0.0),
        (lambda: concatenate([ball(0.04), turned(ball(0.03))]), 1, ball(0.04).volume, 0.0),
        (lambda: concatenate([ball(0.04), turned(ball(0.03)), ball(0.02)]), 1, ball(0.04).volume, 0.0),
        (lambda: soup(concatenate([box(), box(at=(SIDE / 2, 0, 0))])), 1, 1.5 * CUBE, SIDE / 4),
    ],
    ids=[
        "apart",
        "wall to wall",
        "edge to edge",
        "overlapping",
        "on a part of a wall",
        "nested",
        "hollow",
        "core",
        "soup",
    ],
)
def test_several_bodies_are_one_rigid_solid(
    tmp_path: Path, make: Maker, bodies: int, volume: float, center: float
) -> None:
    mesh = load(make(), tmp_path)
    assert mesh.is_volume and mesh.body_count == bodies
    assert mesh.volume == pytest.approx(volume, rel=1e-5)
    assert mesh.center_mass[0] == pytest.approx(center, abs=1e-6)


def test_bodies_that_are_apart_rest_on_the_hull_of_all(tmp_path: Path) -> None:
    concatenate([box(), box(at=(0.1, 0, 0))]).export(tmp_path / "part.stl")
    placements = load_object(tmp_path / "part.stl").placements
    heights = sorted(round(float(p.pose[2, 3] + p.pose[2, :3] @ [0.05, 0, 0]), 6) for p in placements)
    assert heights == [0.02, 0.02, 0.02, 0.02, 0.07, 0.07]


def parts_with_places(folder: Path, suffix: str) -> Path:
    """Write two cubes, the second one moved by what a scene has for it."""
    path, place = folder / f"scene.{suffix}", translation_matrix([0.06, 0, 0])
    if suffix == "glb":
        scene = trimesh.Scene()
        scene.add_geometry(box(), geom_name="cube", node_name="first")
        scene.add_geometry(box(), geom_name="cube", node_name="second", transform=place)
        scene.export(path)
    elif suffix == "dae":
        node = f"<matrix>{' '.join(map(str, place.ravel()))}</matrix>"
        cube = box()
        parts = [(cube.vertices, lambda number: triangles(cube.faces, number), where) for where in ("", node)]
        path.write_text(collada(parts), encoding="utf-8")
    elif suffix == "obj":
        lines = []
        for first, name in ((1, "one"), (9, "two")):
            cube = box(at=(0.06 * (first > 1), 0, 0))
            lines += [f"g {name}", *("v " + " ".join(map(str, v)) for v in cube.vertices)]
            lines += ["f " + " ".join(map(str, f)) for f in cube.faces + first]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    else:
        concatenate([box(), box(at=(0.06, 0, 0))]).export(path)
    return path


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "dae"])
def test_every_format_may_hold_several_bodies(tmp_path: Path, suffix: str) -> None:
    model = load_object(parts_with_places(tmp_path, suffix))
    assert model.mesh.body_count == 2 and model.mesh.volume == pytest.approx(2 * CUBE, rel=1e-5)
    np.testing.assert_allclose(model.mesh.extents, [0.1, SIDE, SIDE], atol=1e-7)


def test_one_sound_body_is_left_alone(tmp_path: Path) -> None:
    mesh = handle()
    mesh.export(tmp_path / "part.ply")
    again = load_object(tmp_path / "part.ply").mesh
    assert np.array_equal(again.faces, mesh.faces) and np.abs(again.vertices - mesh.vertices).max() < 1e-8
    assert compare(mesh, again) is None


@pytest.mark.parametrize(
    ("make", "volume", "off"),
    [
        (wall_in_common, 2 * CUBE, 1e-6),
        (lambda: soup(carton(), noise=2e-5), carton().volume, 0.02),
        (lambda: soup(handle(), noise=1e-5), handle().volume, 0.02),
        (lambda: soup(carton(), noise=1e-7), 360e-6 + np.pi * 0.012**2 * 0.018, 1e-3),
    ],
    ids=["a wall in common", "cracked carton", "cracked handle", "fine cracks"],
)
def test_what_is_not_closed_is_remeshed_and_said_with_numbers(
    tmp_path: Path, make: Maker, volume: float, off: float, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(MeshError, match=r"not watertight.*--repair"):
        load(make(), tmp_path)
    with caplog.at_level(logging.WARNING):
        mesh = load(make(), tmp_path, repair=True)
    assert mesh.is_volume and mesh.volume == pytest.approx(volume, rel=off)
    assert f"-> {1e6 * mesh.volume:.2f} cm3, surfaces at most" in caplog.text
    found = compare(make(), mesh)
    assert found is not None and found.distance < mesh.extents.max() / CELLS


@pytest.mark.parametrize("make", [handle, ball, carton], ids=lambda make: make.__name__)
def test_a_remesh_stays_within_a_cell_of_a_sound_mesh(make: Callable[..., trimesh.Trimesh]) -> None:
    mesh = make(0.04) if make is ball else make()
    solid = remeshed(mesh)
    found = compare(mesh, solid)
    assert solid.is_volume and solid.body_count == 1
    assert found is None or found.distance < mesh.extents.max() / CELLS
    assert solid.volume == pytest.approx(mesh.volume, rel=0.005)


@pytest.mark.parametrize(
    ("make", "volume"),
    [
        (cup, 0.002 * cup().area),
        (plate, 2e-5),
        (lambda: concatenate([plate(), turned(plate())]), 2e-5),
    ],
    ids=["cup", "plate", "both sides"],
)
def test_sheets_are_given_the_thickness_that_is_asked_for(tmp_path: Path, make: Maker, volume: float) -> None:
    for options in ({}, {"repair": True}):
        with pytest.raises(MeshError):
            load(make(), tmp_path, **options)
    sheet, mesh = make(), load(make(), tmp_path, thickness=0.002)
    assert mesh.is_volume and mesh.body_count == 1 and mesh.volume == pytest.approx(volume, rel=1e-3)
    assert trimesh.proximity.signed_distance(mesh, sheet.triangles_center) == pytest.approx(0.001, abs=1e-5)


def test_bends_keep_the_thickness_and_solid_parts_their_shape(tmp_path: Path) -> None:
    tray = box((0.1, 0.08, 0.06))
    tray.update_faces(tray.face_normals[:, 2] < 0.5)
    assert load(tray, tmp_path, thickness=0.002).volume == pytest.approx(
        0.102 * 0.082 * 0.061 - 0.098 * 0.078 * 0.059, rel=1e-5
    )
    mug = load(concatenate([cup(), handle()]), tmp_path, thickness=0.002)
    alone = load(cup(), tmp_path, thickness=0.002)
    common = trimesh.boolean.intersection([alone, handle()], engine="manifold")
    assert mug.volume == pytest.approx(alone.volume + handle().volume - common.volume, rel=1e-4)


def test_a_thickness_is_refused_where_there_is_no_sheet_or_it_makes_no_sense(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"no open sheet.*omit --thickness"):
        load(box(), tmp_path, thickness=0.002)
    with pytest.raises(OptionError, match="built-in mug has no open sheet"):
        load_object("mug", thickness=0.002)
    for thickness in (0.0, -0.001, 2.0, float("nan")):
        with pytest.raises(OptionError, match=r"thickness is .* at most 0\.02 m"):
            load(cup(), tmp_path, thickness=thickness)


@pytest.mark.parametrize(
    ("make", "options", "goal"),
    [
        (carton, {}, 1),
        (lambda: concatenate([box(), box(at=(0.06, 0, 0))]), {}, 1),
        (lambda: concatenate([cup(), handle()]), {"thickness": 0.002}, 1),
        (lambda: soup(carton(), noise=2e-5), {"repair": True}, 1),
    ],
    ids=["overlapping", "apart", "sheet", "remeshed"],
)
def test_a_plan_comes_out_of_it_that_another_process_can_check(
    tmp_path: Path, make: Maker, options: dict, goal: int
) -> None:
    make().export(tmp_path / "part.stl")
    problem = RegraspProblem.load(tmp_path / "part.stl", "nova2-w", **options)
    plan = solve_sequence(problem, problem.pose(0, -0.2, 0.35), problem.pose(goal, 0.2, 0.3, 1.5), refiner="exact")
    assert plan.status.name == "SOLVED"
    plan.save(tmp_path / "plan.json")
    again = RegraspPlan.load(tmp_path / "plan.json")
    assert again.problem.object.fingerprint() == problem.object.fingerprint()
    assert again.residuals().hold
