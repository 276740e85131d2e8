"""Contacts, frames and pads against plane geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.geometry.shapes import surface_points
from regrasp_opt.grasps.antipodal import contact_depths, contact_pairs
from regrasp_opt.grasps.candidates import frames_about
from regrasp_opt.grasps.clearance import GripperClearance
from regrasp_opt.grasps.surface import TriangleSurface, cast_rays, make_surface, sample_points


def wedge(apex: float, base: float = 0.05, length: float = 0.3) -> TriangleSurface:
    """Return a prism with an isosceles section: its apex angle [deg] is on top, its base on z = 0."""
    height = base / 2 / np.tan(np.deg2rad(apex) / 2)
    section = np.array([[-base / 2, 0.0], [base / 2, 0.0], [0.0, height]])
    ends = [np.insert(section, 1, side, axis=1) for side in (-length / 2, length / 2)]
    return make_surface(trimesh.convex.convex_hull(np.vstack(ends)))


@pytest.mark.parametrize(("apex", "held"), [(20.0, True), (50.0, True), (56.0, False), (60.0, False), (66.0, False)])
def test_a_wedge_is_held_where_rubber_does_not_slide_off(apex: float, held: bool) -> None:
    """Two planes are in both friction cones of a line as long as their angle is at most ``2 atan(0.5)``, 53 degrees.

    The ends of the prism are farther apart than the jaw opens, and its other angles are wider still.
    """
    middle, closing, width = contact_pairs(wedge(apex), load_end_effector("w"), 6000, np.random.default_rng(0))
    assert (len(width) > 0) == held
    if held:
        assert (np.abs(closing[:, 1]) < 0.5).all() and (middle[:, 2] > 0).all()


def test_contacts_are_on_the_surface_and_pull_into_their_friction_cones() -> None:
    mesh = trimesh.creation.box(extents=(0.04, 0.06, 0.3))
    surface = make_surface(mesh)
    tool = load_end_effector("w")
    middle, closing, width = contact_pairs(surface, tool, 500, np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.norm(closing, axis=1), 1.0)
    straight = 0
    for side in (-1.0, 1.0):
        points = middle + side * 0.5 * width[:, None] * closing
        _, gap, face = trimesh.proximity.closest_point(mesh, points)
        cosine = np.einsum("ij,ij->i", mesh.face_normals[face], side * closing)
        assert gap.max() < 1e-9 and np.tan(np.arccos(cosine.clip(-1, 1))).max() <= 0.5 + 1e-6
        straight += int((cosine > 1 - 1e-9).sum())
    assert width.min() >= 0.04 - 1e-9 and width.max() <= tool.max_opening - 2 * tool.pre_opening
    assert straight >= len(width) / 2  # one of the two rays goes straight through, the other is tilted
    tilt = np.sqrt(1 - np.abs(closing).max(axis=1) ** 2)
    assert np.tan(np.arcsin(tilt.max())) > 0.45 and len(width) > 500


def test_tilted_rays_fill_the_friction_cone_evenly() -> None:
    """On a cube every ray in the cone meets the face opposite, or the next one outside its cone."""
    surface = make_surface(trimesh.creation.box(extents=(0.05, 4.0, 4.0)))
    _, closing, _ = contact_pairs(surface, load_end_effector("r140"), 4000, np.random.default_rng(2))
    slope = np.hypot(closing[:, 1], closing[:, 2]) / np.abs(closing[:, 0])
    tilted = slope[slope > 1e-9] / 0.5
    assert len(tilted) > 3000
    for share in (0.25, 0.5, 0.75):
        assert (tilted < share).mean() == pytest.approx(share**2, abs=0.03)
    angle = np.arctan2(closing[slope > 1e-9, 2], closing[slope > 1e-9, 1])
    np.testing.assert_allclose(np.histogram(angle, 4, (-np.pi, np.pi))[0] / len(angle), 0.25, atol=0.03)


def test_with_verticals_some_closing_lines_are_level() -> None:
    """The sides of this prism slope by 20 degrees, so that a level line is in their friction cones, but not normal."""
    up = np.array([[0.0, 0.0, 1.0]])
    for verticals in (None, up):
        _, closing, _ = contact_pairs(wedge(40.0), load_end_effector("w"), 4000, np.random.default_rng(0), verticals)
        level = (np.abs(closing[:, 2]) < 1e-9).mean()
        assert level > 0.1 if verticals is not None else level == 0.0


@pytest.mark.parametrize("closing", [True, False])
def test_frames_turn_evenly_about_their_axis(closing: bool) -> None:
    rng = np.random.default_rng(3)
    axis = rng.normal(size=(7, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    positions = rng.normal(size=(7, 3))
    toward = rng.normal(size=(7, 3))
    frames = frames_about(positions, axis, 6, toward, closing=closing).reshape(7, 6, 4, 4)
    rotation = frames[..., :3, :3]
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, -1, -2), np.broadcast_to(np.eye(3), (7, 6, 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)
    np.testing.assert_array_equal(frames[..., 3, :], np.broadcast_to([0, 0, 0, 1], (7, 6, 4)))
    np.testing.assert_allclose(frames[..., :3, 3], np.broadcast_to(positions[:, None], (7, 6, 3)))
    fixed, spoke = (1, 2) if closing else (2, 1)
    np.testing.assert_allclose(rotation[..., fixed], np.broadcast_to(axis[:, None], (7, 6, 3)), atol=1e-12)
    cosine = np.einsum("nti,nti->nt", rotation[..., spoke], np.roll(rotation[..., spoke], 1, axis=1))
    np.testing.assert_allclose(cosine, np.cos(np.deg2rad(60)), atol=1e-12)
    across = toward - np.einsum("ni,ni->n", toward, axis)[:, None] * axis
    np.testing.assert_allclose(rotation[:, 0, :, spoke], across / np.linalg.norm(across, axis=1, keepdims=True))


@pytest.mark.parametrize("name", ["w", "r85", "r140"])
def test_contacts_lie_on_the_pads_and_near_the_tip_last(name: str) -> None:
    tool = load_end_effector(name)
    depths = contact_depths(tool)
    low, high = (edge - tool.tcp_offset for edge in tool.pad.z)
    assert len(depths) == len(set(depths)) >= 1 and high - low > 0.008
    assert min(depths) >= low + 0.004 - 1e-12 and max(depths[:-2]) == pytest.approx(high - 0.004)
    assert depths[-2:] == pytest.approx([high - 0.002, high - 0.0005])
    thin = replace(tool, pad=tool.pad._replace(z=(tool.tcp_offset - 0.003, tool.tcp_offset + 0.001)))
    assert contact_depths(thin) == pytest.approx([-0.001, 0.0005])  # the middle, where there is no room for more


@pytest.mark.parametrize(("thickness", "held"), [(0.0008, False), (0.0012, True)])
def test_sheets_of_a_millimetre_are_held(thickness: float, held: bool) -> None:
    sheet = make_surface(trimesh.creation.box(extents=(0.3, thickness, 0.3)))
    assert (len(contact_pairs(sheet, load_end_effector("w"), 50, np.random.default_rng(0))[2]) > 0) == held


def test_a_line_crosses_a_ball_where_it_should() -> None:
    ball = make_surface(trimesh.creation.icosphere(subdivisions=4, radius=1.0))
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = 1.2 * rng.uniform(-1, 1, (60, 3))
    hits = cast_rays(ball, origins, directions)
    along = -np.einsum("ij,ij->i", origins, directions)
    aside = np.linalg.norm(origins + along[:, None] * directions, axis=1)
    for ray in range(60):
        mine = np.sort(hits.distance[hits.ray == ray])
        if aside[ray] > 1.0:
            assert len(mine) == 0
        elif aside[ray] < 0.95:
            half = np.sqrt(1 - aside[ray] ** 2)
            np.testing.assert_allclose(mine, [along[ray] - half, along[ray] + half], atol=0.02)
    outward = np.einsum("ij,ij->i", ball.normals, ball.triangles.mean(axis=1))
    assert (outward > 0.9).all() and ball.areas.sum() == pytest.approx(4 * np.pi, rel=0.01)


def test_a_line_through_a_vertex_meets_the_surface() -> None:
    """Lines along the axes pass exactly where boxes of triangles end, too."""
    mesh = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
    for _ in range(3):
        mesh = mesh.subdivide()
    inner = mesh.vertices[(np.abs(mesh.vertices[:, :2]) < 0.049).all(axis=1)]
    assert len(np.unique(inner[:, :2], axis=0)) > 40
    hits = cast_rays(make_surface(mesh), inner * [1, 1, 0], np.tile([0.0, 0.0, 1.0], (len(inner), 1)))
    for side in (-0.05, 0.05):
        assert set(hits.ray[np.abs(hits.distance - side) < 1e-12]) == set(range(len(inner)))


def test_creases_are_edges_that_bend_by_more_than_25_degrees() -> None:
    box = make_surface(trimesh.creation.box(extents=(0.04, 0.06, 0.08)))
    assert len(box.creases) == 12 and box.crease_angles == pytest.approx(np.full(12, np.pi / 2))
    np.testing.assert_allclose(
        np.sort(np.linalg.norm(box.creases[:, 1] - box.creases[:, 0], axis=1)), np.repeat([0.04, 0.06, 0.08], 4)
    )
    for sides, sharp in ((12, True), (16, False)):  # 30 and 22.5 degrees an edge, and the rims of both ends
        prism = make_surface(trimesh.creation.cylinder(radius=0.03, height=0.1, sections=sides))
        assert len(prism.creases) == (3 if sharp else 2) * sides


@pytest.mark.parametrize("span", [(0.0, 0.02), (-0.01, 0.005), (0.0, np.inf)])
def test_a_span_keeps_the_crossings_within_it_and_no_others(span: tuple[float, float]) -> None:
    surface, rng = make_surface(trimesh.creation.torus(0.03, 0.01)), np.random.default_rng(6)
    points, _ = sample_points(surface, 400, rng)
    origins, directions = points + rng.normal(0, 0.01, points.shape), rng.normal(size=points.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    everything, found = cast_rays(surface, origins, directions), cast_rays(surface, origins, directions, span)
    within = (everything.distance >= span[0]) & (everything.distance <= span[1])
    assert 0 < within.sum() < len(within)
    for whole, part in zip(everything, found, strict=True):
        np.testing.assert_array_equal(whole[within], part)


def test_points_fill_a_triangle_evenly() -> None:
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    points, _ = sample_points(make_surface(triangle), 6000, np.random.default_rng(5))
    assert (points[:, :2] >= 0).all() and (points[:, :2].sum(axis=1) <= 1).all() and (points[:, 2] == 0).all()
    np.testing.assert_allclose(points[:, :2].mean(axis=0), 1 / 3, atol=0.015)
    np.testing.assert_allclose(np.cov(points[:, :2].T), np.array([[1, -0.5], [-0.5, 1]]) / 18, atol=0.003)


@pytest.mark.parametrize(("overlap", "free"), [(0.0008, True), (0.0012, False)])
def test_fingers_may_overlap_a_contact_by_a_millimetre(overlap: float, free: bool) -> None:
    """They are checked where they begin to open; less is what bumpy sides and rounded poses take."""
    box = trimesh.creation.box(extents=(0.02, 0.05, 0.2))
    clearance = GripperClearance(box.vertices, box.faces, load_end_effector("w"))
    T = np.eye(4)
    T[2, 3] = -0.09  # near the lower end, from below
    assert clearance.fingers_free(T[None], np.array([0.05 - 2 * overlap])).tolist() == [free]


@pytest.mark.parametrize(("gap", "free"), [(0.0015, False), (0.0025, True)])
def test_the_body_of_a_jaw_stays_2_mm_away_and_a_cup_may_touch(gap: float, free: bool) -> None:
    plate = trimesh.creation.box(extents=(0.3, 0.3, 0.02))
    for name, allowed in (("w", free), ("s1", True)):
        tool = load_end_effector(name)
        top = max(float(surface_points(shape)[:, 2].max()) for shape in tool.body)  # in the flange frame
        T = np.eye(4)
        T[2, 3] = -0.01 - gap - top + tool.tcp_offset  # from below: the body's top is `gap` under the plate
        assert GripperClearance(plate.vertices, plate.faces, tool).body_free(T[None]).tolist() == [allowed]
