"""Axes of rotational symmetry, found on the surface."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt.objects import load_object
from regrasp_opt.objects.symmetry import is_symmetry, symmetries, turn_about


def prism(sides: int) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(0.04, 0.03, sections=sides)


def bumped() -> trimesh.Trimesh:
    bump = trimesh.creation.box(bounds=[[0.035, -0.004, -0.004], [0.046, 0.004, 0.004]])
    return trimesh.boolean.union([prism(64), bump], engine="manifold")


SHAPES: dict[str, tuple[Callable[[], trimesh.Trimesh], int | None]] = {
    "pentagon": (lambda: prism(5), 5),
    "twelve sides": (lambda: prism(12), 12),
    "can": (lambda: prism(64), None),
    "ring": (lambda: trimesh.creation.annulus(0.02, 0.03, 0.01, sections=48), None),
    "square rod": (lambda: trimesh.creation.box((0.03, 0.03, 0.2)), 4),
    "bumped can": (bumped, 1),
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_order_of_the_axis_is_found_however_the_object_is_turned(name: str, tmp_path: Path) -> None:
    make, order = SHAPES[name]
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5])
    mesh = make()
    mesh.apply_transform(turn_about(np.array([0.1, 0.2, 0.0]), turn.as_rotvec()))
    mesh.export(tmp_path / "part.ply")
    model = load_object(tmp_path / "part.ply")
    found = symmetries(model)
    if name == "bumped can":  # its axis is none; a half turn about the bump is one
        assert [each.order for each in found] == [2]
        np.testing.assert_allclose(np.abs(found[0].axis @ turn.as_matrix()), [1, 0, 0], atol=1e-4)
        return
    assert len(found) == 1 and found[0].order == order
    np.testing.assert_allclose(np.abs(found[0].axis @ turn.as_matrix()), [0, 0, 1], atol=1e-4)
    turns = found[0].turns(24)
    assert len(turns) == (order or 24) - 1 and (np.abs(turns) <= np.pi + 1e-9).all()
    assert len(np.unique(np.round(turns, 9))) == len(turns)
    for angle in turns:
        assert is_symmetry(model, angle * found[0].axis)


@pytest.mark.parametrize(("edge", "united"), [(0.02, True), (0.004, True), (0.004, False)])
def test_a_pin_is_seen_however_fine_the_mesh_is(edge: float, united: bool, tmp_path: Path) -> None:
    can = trimesh.creation.cylinder(0.03, 0.1, sections=96)
    pin = trimesh.creation.box(bounds=[[0.029 if united else 0.031, -0.003, -0.003], [0.061, 0.003, 0.003]])
    whole = trimesh.boolean.union([can, pin], engine="manifold") if united else trimesh.util.concatenate([can, pin])
    vertices, faces = trimesh.remesh.subdivide_to_size(whole.vertices, whole.faces, edge)
    trimesh.Trimesh(vertices, faces).export(tmp_path / "part.stl")
    model = load_object(tmp_path / "part.stl")
    assert all(abs(each.axis[0]) > 0.99 and each.order == 2 for each in symmetries(model))
    for angle in (0.5, np.pi / 2, np.pi):
        assert not is_symmetry(model, np.array([0.0, 0.0, angle]))


def test_of_several_axes_those_of_the_highest_order_count(tmp_path: Path) -> None:
    trimesh.creation.box((0.05, 0.05, 0.05)).export(tmp_path / "cube.stl")
    assert [each.order for each in symmetries(load_object(tmp_path / "cube.stl"))] == [4, 4, 4]
    trimesh.creation.box((0.03, 0.04, 0.05)).export(tmp_path / "box.stl")
    assert [each.order for each in symmetries(load_object(tmp_path / "box.stl"))] == [2, 2, 2]


@pytest.mark.parametrize(("name", "order"), [("bottle", 4), ("pentagon", 5), ("mug", 0), ("figurine", 0)])
def test_built_in_objects(name: str, order: int) -> None:
    assert [each.order for each in symmetries(load_object(name))] == ([order] if order else [])


def test_weight_beside_the_axis_ends_the_symmetry(tmp_path: Path) -> None:
    prism(64).export(tmp_path / "can.stl")
    assert symmetries(load_object(tmp_path / "can.stl", center_of_mass=(0.0, 0.0, 0.005)))[0].order is None
    beside = symmetries(load_object(tmp_path / "can.stl", center_of_mass=(0.005, 0.0, 0.0)))
    assert all(each.order == 2 and abs(each.axis[0]) > 0.999 for each in beside)


def test_a_turn_that_changes_it_is_none() -> None:
    model = load_object("pentagon")
    assert is_symmetry(model, np.array([0.0, 0.0, 4 * np.pi / 5]))
    assert not is_symmetry(model, np.array([0.0, 0.0, np.pi / 5])) and not is_symmetry(model, np.array([1.0, 0.0, 0.0]))
