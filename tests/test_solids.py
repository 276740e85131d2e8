"""What is inside a closed mesh, however it is wound, and what is not."""

import coal
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import translation
from regrasp_opt.geometry.shapes import mesh_geometry
from regrasp_opt.geometry.solids import Solid, distance, find_shells, nested

BOX = trimesh.creation.box((1, 1, 1))
SMALL = trimesh.creation.box((0.5, 0.5, 0.5))
CENTER, WALL, OUT, BESIDE = [0.1, 0.1, 0.1], [0.4, 0.4, 0.4], [0.9, 0.4, 0.4], [3.1, 0.1, 0.1]


def inverted(mesh):
    mesh = mesh.copy()
    mesh.invert()
    return mesh


def moved(mesh, *xyz):
    mesh = mesh.copy()
    mesh.apply_translation(xyz)
    return mesh


def raw(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False)


def mixed():
    faces = BOX.faces.copy()
    faces[::3] = faces[::3, ::-1]
    return raw(BOX.vertices, faces)


def both(*meshes):
    return trimesh.util.concatenate(meshes)


def mirrored():
    """Return a box beside `BOX` that has the same wall, wound oppositely there."""
    return raw(BOX.vertices * [-1, 1, 1] + [1, 0, 0], BOX.faces[:, ::-1])


FIN = raw(np.vstack([BOX.vertices[BOX.faces[0, :2]], [[0.0, 5.0, 5.0]]]), [[0, 1, 2]])


MESHES = {
    "a box": (BOX, [True, True, False, False]),
    "inside out": (inverted(BOX), [True, True, False, False]),
    "faces wound both ways": (mixed(), [True, True, False, False]),
    "every face on its own": (
        raw(BOX.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3)),
        [True, True, False, False],
    ),
    "every face twice": (raw(BOX.vertices, np.vstack([BOX.faces, BOX.faces[:, ::-1]])), [True, True, False, False]),
    "boxes with a wall in common": (both(BOX, mirrored()), [True, True, True, False]),
    "boxes with a wall in common, one inside out": (both(BOX, inverted(mirrored())), [True, True, True, False]),
    "boxes with a wall in common, both inside out": (
        both(inverted(BOX), inverted(mirrored())),
        [True, True, True, False],
    ),
    "boxes with a wall in common, a face twice": (
        both(BOX, mirrored(), raw(BOX.vertices, BOX.faces[(BOX.triangles[:, :, 0] < 0).all(axis=1)][:1])),
        [True, True, True, False],
    ),
    "an open box at a wall in common": (
        both(BOX, raw(mirrored().vertices, [f for f in mirrored().faces if (mirrored().vertices[f][:, 0] < 1).any()])),
        [False, False, False, False],
    ),
    "a box with a fin of two sides": (both(BOX, FIN, inverted(FIN)), [True, True, False, False]),
    "an open sheet of two sides": (both(FIN, inverted(FIN)), [False, False, False, False]),
    "a cavity": (both(BOX, inverted(SMALL)), [False, True, False, False]),
    "a cavity inside out": (both(inverted(BOX), SMALL), [False, True, False, False]),
    "a solid within a solid": (both(BOX, SMALL), [True, True, False, False]),
    "two boxes, one inside out": (both(BOX, moved(inverted(BOX), 3, 0, 0)), [True, True, False, True]),
    "overlapping boxes": (both(BOX, moved(BOX, 0.5, 0.1, 0.1)), [True, True, True, False]),
    "overlapping boxes, one inside out": (both(BOX, moved(inverted(BOX), 0.5, 0.1, 0.1)), [True, True, True, False]),
    "open": (raw(BOX.vertices, BOX.faces[1:]), [False, False, False, False]),
    "an open box and a closed one": (
        both(raw(BOX.vertices, BOX.faces[1:]), moved(BOX, 3, 0, 0)),
        [False, False, False, True],
    ),
    "scaled to millimetres and mirrored": (raw(BOX.vertices * [1, -1, 1], BOX.faces), [True, True, False, False]),
}


def solid(mesh):
    return Solid(mesh_geometry(mesh.vertices, mesh.faces))


@pytest.mark.parametrize("name", MESHES)
def test_points_are_inside_closed_parts_but_not_in_cavities(name):
    mesh, expected = MESHES[name]
    body = solid(mesh)
    assert [body.holds(np.array([point])) for point in (CENTER, WALL, OUT, BESIDE)] == expected
    assert body.shells.open_parts == name.count("open")


@pytest.mark.parametrize("shift", np.linspace(0, 1e-7, 5))
def test_vertices_that_differ_by_rounding_are_one_wherever_they_lie(shift):
    noise = np.random.default_rng(0).uniform(-1, 1, (36, 3)) * 2e-8
    body = solid(raw(BOX.triangles.reshape(-1, 3) + noise + shift, np.arange(36).reshape(-1, 3)))
    assert body.shells.open_parts == 0 and body.holds(np.array([CENTER])) and not body.holds(np.array([OUT]))
    apart = solid(raw(BOX.triangles.reshape(-1, 3) + 1e3 * noise, np.arange(36).reshape(-1, 3)))
    assert apart.shells.open_parts == 12


def test_points_about_a_concave_mesh_agree_with_its_analytic_inside():
    ring = trimesh.creation.annulus(0.1, 0.2, 0.3, sections=64)
    points = np.random.default_rng(0).uniform(-0.25, 0.25, (400, 3))
    radius = np.linalg.norm(points[:, :2], axis=1)
    clear = (np.abs(radius - 0.1) > 0.002) & (np.abs(radius - 0.2) > 0.002)
    expected = (radius > 0.1) & (radius < 0.2) & (np.abs(points[:, 2]) < 0.15)
    found = np.array([solid(ring).holds(point[None]) for point in points])
    np.testing.assert_array_equal(found[clear], expected[clear])
    assert 20 < expected.sum() < 200


PRIMITIVES = {
    "box": coal.Box(0.2, 0.2, 0.2),
    "cylinder": coal.Cylinder(0.1, 0.2),
    "sphere": coal.Sphere(0.1),
    "capsule": coal.Capsule(0.1, 0.1),
}


@pytest.mark.parametrize("kind", PRIMITIVES)
def test_a_body_in_a_mesh_and_a_mesh_in_a_body_have_negative_distances(kind):
    outer, body = solid(BOX), Solid(PRIMITIVES[kind])
    tiny = solid(trimesh.creation.icosphere(2, 0.01))
    assert distance(outer, body, np.eye(4), np.eye(4)) < -0.05
    assert distance(body, outer, translation(0.2, 0.1, 0.0), np.eye(4)) < -0.05
    assert distance(body, tiny, np.eye(4), translation(0.02, 0.01, 0.0)) < -0.05  # solid to Coal already
    assert distance(outer, body, np.eye(4), translation(1.0, 0.0, 0.0)) == pytest.approx(0.4, abs=1e-6)
    hollow = solid(MESHES["a cavity"][0])
    assert distance(hollow, body, np.eye(4), np.eye(4)) >= 0.1 - 1e-9


def test_meshes_that_overlap_or_hold_each_other_have_negative_distances():
    outer, inner = solid(BOX), solid(SMALL)
    assert distance(outer, inner, np.eye(4), translation(0.45, 0.1, 0.03)) < -0.1
    for a, b in ((outer, inner), (inner, outer)):
        assert nested(a, b, translation(0.1, 0.1, 0.0))
        assert distance(a, b, np.eye(4), translation(0.1, 0.1, 0.0)) < -0.1
        assert not nested(a, b, translation(1.0, 0.0, 0.0))


def test_every_part_of_a_body_is_tested():
    pair = solid(both(moved(SMALL, 5, 0, 0), moved(trimesh.creation.icosphere(2, 0.1), 0, 0, 0)))
    assert nested(solid(BOX), pair, np.eye(4))
    assert not nested(solid(BOX), pair, translation(2.0, 0.0, 0.0))


def test_shells_of_a_fine_mesh_are_found_after_export_with_single_precision(tmp_path):
    mesh = trimesh.creation.icosphere(4, 0.05)
    mesh.apply_translation([0.3, 0.2, 0.1])
    mesh.export(tmp_path / "ball.stl")
    loaded = trimesh.load_mesh(tmp_path / "ball.stl", process=False)
    shells = find_shells(np.array(loaded.vertices), np.array(loaded.faces))
    assert shells.open_parts == 0 and len(shells.points) == 1 and len(shells.triangles) == len(mesh.faces)


def test_a_mesh_of_slivers_has_no_inside_and_is_in_nothing():
    slivers = solid(raw(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0]]), np.array([[0, 1, 2], [0, 1, 1]])))
    assert len(slivers.shells.points) == 0 and not slivers.holds(np.zeros((1, 3)))
    assert not solid(BOX).may_hold(slivers) and not slivers.may_hold(solid(BOX))
    assert not nested(solid(BOX), slivers, np.eye(4))


@pytest.mark.parametrize("depth", [0.0005, 0.003, 0.008])
@pytest.mark.parametrize("seed", range(4))
def test_a_primitive_in_the_surface_of_a_fine_mesh_is_no_small_overlap(depth, seed):
    """Coal ends at the first triangle that it finds overlapping, however little that one is overlapped."""
    ball = trimesh.creation.icosphere(4, 0.05)
    body = Solid(mesh_geometry(ball.vertices, ball.faces))
    finger = Solid(coal.Box(0.02, 0.004, 0.06))
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = T[:3, 1] * (0.05 + 0.002 - depth)  # its thin side against the ball
    found = distance(finger, body, T, np.eye(4))
    assert found < -depth
    T[:3, 3] = T[:3, 1] * (0.05 + 0.002 + depth)
    assert 0.9 * depth < distance(finger, body, T, np.eye(4)) < 1.6 * depth
