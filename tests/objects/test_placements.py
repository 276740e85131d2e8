from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_opt.errors import MeshError
from regrasp_opt.objects import OBJECT_NAMES, load_object, stable_placements
from regrasp_opt.objects.placements import rotation_to_down

SHARED = Path(__file__).parents[3] / "shared" / "objects"

quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


def turned(mesh: trimesh.Trimesh, quaternion: tuple[float, ...], shift: float = 0.0) -> trimesh.Trimesh:
    vertices = mesh.vertices @ Rotation.from_quat(quaternion).as_matrix().T + shift
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def placed(mesh: trimesh.Trimesh, pose: np.ndarray) -> np.ndarray:
    return mesh.vertices @ pose[:3, :3].T + pose[:3, 3]


@pytest.mark.parametrize(("name", "count"), [("bunny", 7), ("pentagon", 7), ("mug", 2)])
def test_meshes_of_the_paper_have_its_counts(name: str, count: int) -> None:
    path = SHARED / f"{name}.stl"
    if not path.exists():
        pytest.skip("the paper's meshes are not here")
    assert len(load_object(path).placements) == count


@pytest.mark.parametrize(("name", "count"), [("bottle", 5), ("mug", 4), ("pentagon", 7), ("figurine", 5)])
def test_built_in_objects_have_known_counts(name: str, count: int) -> None:
    margins = [placement.margin for placement in load_object(name).placements]
    assert len(margins) == count and min(margins) >= 0.1
    assert margins == sorted(margins, reverse=True) or np.ptp(np.diff(margins).clip(min=0)) < 1e-6


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_objects_truly_rest_on_what_touches_the_table(name: str) -> None:
    model = load_object(name)
    for placement in model.placements:
        np.testing.assert_allclose(placement.pose[:3, :3] @ placement.pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(placement.pose) == pytest.approx(1.0)
        points = placed(model.mesh, placement.pose)
        assert abs(points[:, 2].min()) < 1e-9
        center = placement.pose[:3, :3] @ model.center_of_mass + placement.pose[:3, 3]
        np.testing.assert_allclose(center[:2], 0.0, atol=1e-12)
        support = points[points[:, 2] < 1e-6, :2]
        assert ConvexHull(support).equations[:, 2].max() < 0.0


def test_margin_of_a_box_is_its_half_width_over_its_half_height() -> None:
    placements = stable_placements(trimesh.creation.box(extents=(0.04, 0.06, 0.10)), min_margin=0.0)
    np.testing.assert_allclose(
        [placement.margin for placement in placements], [1.5, 1.5, 2 / 3, 2 / 3, 0.4, 0.4], rtol=1e-9
    )


@settings(deadline=None, max_examples=25)
@given(quaternion=quaternions, shift=st.floats(-0.5, 0.5), subdivisions=st.integers(0, 2))
def test_a_cube_has_six_however_it_is_turned_or_cut(
    quaternion: tuple[float, ...], shift: float, subdivisions: int
) -> None:
    cube = trimesh.creation.box(extents=(0.05, 0.05, 0.05))
    for _ in range(subdivisions):
        cube = cube.subdivide()
    cube = turned(cube, quaternion, shift)
    placements = stable_placements(cube)
    np.testing.assert_allclose([placement.margin for placement in placements], np.ones(6), rtol=1e-6)
    for placement in placements:
        assert placed(cube, placement.pose)[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_poses_do_not_depend_on_the_triangulation() -> None:
    coarse = trimesh.creation.box(extents=(0.04, 0.06, 0.10))
    for a, b in zip(stable_placements(coarse), stable_placements(coarse.subdivide()), strict=True):
        np.testing.assert_allclose(a.pose, b.pose, atol=1e-9)


@settings(deadline=None, max_examples=10)
@given(quaternion=quaternions)
def test_margins_do_not_depend_on_the_object_frame(quaternion: tuple[float, ...]) -> None:
    model = load_object("figurine")
    found = stable_placements(turned(model.mesh, quaternion, 0.1))
    expected = [placement.margin for placement in model.placements]
    np.testing.assert_allclose([placement.margin for placement in found], expected, rtol=1e-6)


def test_a_flat_mesh_is_refused() -> None:
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]])
    flat = trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]], process=False)
    flat.center_mass = corners.mean(axis=0)
    with pytest.raises(MeshError, match="flat"):
        stable_placements(flat)


@given(quaternion=quaternions)
def test_rotation_to_down_is_a_rotation(quaternion: tuple[float, ...]) -> None:
    normal = Rotation.from_quat(quaternion).as_matrix()[:, 2]
    rotation = rotation_to_down(normal)
    np.testing.assert_allclose(rotation @ normal, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_yaw_is_stable_near_the_poles() -> None:
    for pole in ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)):
        nudged = np.array([1e-7, -1e-7, pole[2]])
        difference = rotation_to_down(np.array(pole)) - rotation_to_down(nudged / np.linalg.norm(nudged))
        assert np.abs(difference).max() < 1e-6
