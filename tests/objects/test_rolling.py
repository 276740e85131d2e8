"""What rolls, and what rests, however it is cut."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from regrasp_opt.objects import OBJECT_NAMES, ObjectModel, load_object, stable_placements
from regrasp_opt.objects.rolling import DIP, FAR, Hull

SHARED = Path(__file__).parents[3] / "shared" / "objects" / "ycb"
SIDES = (12, 13, 16, 24, 30, 48, 64)


def turned_body(profile, sides, scale=(1, 1, 1)):
    """A convex body of revolution about z with the radii and heights of `profile`, cut into `sides`."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, z)]) for r, z in profile]
    return trimesh.convex.convex_hull(np.concatenate(rings) * scale)


def egg(sides):
    t = np.linspace(-1, 1, sides // 2)
    return turned_body(np.column_stack([0.022 * np.sqrt(1 - t * t) * (1 + 0.15 * t) + 1e-9, 0.03 * t]), sides)


def half_cylinder(sides, offset):
    angle = np.pi * (np.arange(sides) + offset) * 2 / sides
    angle = np.concatenate([[0.0, np.pi], angle[angle < np.pi]])
    outline = 0.03 * np.column_stack([np.cos(angle), np.sin(angle)])
    return trimesh.convex.convex_hull(np.concatenate([np.column_stack([outline, 0 * angle + z]) for z in (0, 0.08)]))


ROUND = {
    "can": (2, lambda n: trimesh.creation.cylinder(0.03, 0.1, sections=n)),
    "coin": (2, lambda n: trimesh.creation.cylinder(0.03, 0.01, sections=n)),
    "rod": (2, lambda n: trimesh.creation.cylinder(0.015, 0.12, sections=n)),
    "oval": (2, lambda n: trimesh.creation.cylinder(0.03, 0.1, sections=n).apply_scale([1.1, 1, 1])),
    "capsule": (0, lambda n: trimesh.creation.capsule(height=0.08, radius=0.02, count=[n // 2, n])),
    "ball": (0, lambda n: trimesh.creation.uv_sphere(radius=0.03, count=[n // 2, n])),
    "torus": (2, lambda n: trimesh.creation.torus(0.04, 0.01, major_sections=n, minor_sections=n)),
    "slim cone": (1, lambda n: turned_body([(1e-9, 0.1), (0.03, 0)], n)),
    "flat cone": (1, lambda n: turned_body([(1e-9, 0.02), (0.03, 0)], n)),
    "cup": (2, lambda n: turned_body([(0.03, 0), (0.024, 0.08)], n)),
    "bottle": (1, lambda n: turned_body([(0.03, 0), (0.03, 0.12), (0.01, 0.15), (0.01, 0.2)], n)),
    "barrel": (2, lambda n: turned_body([(0.025, 0), (0.03, 0.03), (0.031, 0.04), (0.03, 0.05), (0.025, 0.08)], n)),
    "egg": (0, egg),
    "half cylinder on a facet": (3, lambda n: half_cylinder(n, 0.0)),
    "half cylinder on an edge": (3, lambda n: half_cylinder(n, 0.5)),
}


@pytest.mark.parametrize("sides", SIDES)
@pytest.mark.parametrize("name", ROUND)
def test_round_bodies_rest_on_their_flat_sides_alone(name, sides):
    count, build = ROUND[name]
    assert len(stable_placements(build(sides))) == count


@pytest.mark.parametrize(("sides", "count"), [(3, 5), (4, 6), (5, 7), (6, 8), (8, 10), (10, 12), (11, 2)])
def test_the_dip_decides_on_which_sides_a_prism_rests(sides, count):
    assert (1 / np.cos(np.pi / sides) - 1 > DIP) == (count > 2)
    for length in (0.04, 0.1):
        assert len(stable_placements(trimesh.creation.cylinder(0.03, length, sections=sides))) == count


def test_dice_rest_on_every_face():
    assert len(stable_placements(trimesh.creation.icosahedron().apply_scale(0.02))) == 20


@pytest.mark.parametrize("subdivisions", [1, 2, 3])
def test_balls_of_triangles_roll(subdivisions):
    assert stable_placements(trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.03)) == ()


@pytest.mark.parametrize("sides", SIDES)
def test_a_mug_rolls_until_its_handle_stops_it(sides):
    handle = trimesh.creation.box(bounds=[[0.035, -0.006, 0.02], [0.065, 0.006, 0.07]])
    cup = trimesh.creation.cylinder(0.04, 0.09, sections=sides).apply_translation([0, 0, 0.045])
    mug = trimesh.boolean.union([cup, handle], engine="manifold")
    placements = stable_placements(mug)
    lying = [p for p in placements if abs(p.pose[2, 2]) < 0.5]
    assert len(placements) == 2 + len(lying)
    for placement in lying:
        heights = mug.vertices @ placement.pose[2, :3] + placement.pose[2, 3]
        assert heights[mug.vertices[:, 0] > 0.06].min() < 1e-9


def test_a_flat_side_stops_a_roll():
    """A dent that dips by more than the bound is a place to rest, a shallower one is not."""
    for depth, count in ((0.5 * DIP, 2), (1.5 * DIP, 3)):
        can = trimesh.creation.cylinder(0.03, 0.1, sections=64).vertices
        dented = np.column_stack([np.minimum(can[:, 0], 0.03 * (1 - depth)), can[:, 1:]])
        assert len(stable_placements(trimesh.convex.convex_hull(dented))) == count


def test_a_side_flat_enough_to_rest_on_is_one_placement():
    """An ellipse of half axes a, b has the radius a^2/b where it is flat: 4 times its height for a = 2 b."""
    for sides in (14, 30, 90, 200):
        flat = trimesh.creation.cylinder(0.03, 0.1, sections=sides).apply_scale([2, 1, 1])
        downs = [-p.pose[2, :3] for p in stable_placements(flat)]
        assert sorted(round(d[1]) for d in downs if abs(d[2]) < 0.5) == [-1, 1]


@pytest.mark.parametrize("name", ["can", "ball", "half cylinder on an edge", "cup"])
def test_how_a_body_is_turned_and_written_does_not_matter(name):
    rng = np.random.default_rng(7)
    count, build = ROUND[name]
    for sides in (16, 24):
        mesh = build(sides)
        vertices = mesh.vertices @ Rotation.random(random_state=rng.integers(2**31)).as_matrix().T + 0.1
        vertices = vertices.astype(np.float32) + rng.normal(0, 1e-6, vertices.shape)
        mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
        assert len(stable_placements(mesh)) == len(stable_placements(mesh.subdivide())) == count


def test_tipping_over_one_edge_never_counts_as_rolling():
    assert np.arccos(1 / (1 + DIP)) + np.arccos((1 - DIP) / (1 + DIP)) < FAR
    slim = trimesh.creation.box(extents=(0.02, 0.02, 0.15))
    assert len(stable_placements(slim)) == 6


def test_passes_are_the_heights_over_edges():
    hull = Hull(trimesh.creation.box(extents=(0.04, 0.06, 0.10)).vertices)
    expected = {np.hypot(a, b) for a, b in ((0.02, 0.03), (0.02, 0.05), (0.03, 0.05))}
    assert {round(p, 9) for p in hull._pass} == {round(p, 9) for p in expected | {0.02, 0.03, 0.05}}


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_no_object_rolls_in_a_stable_placement(name):
    model = load_object(name)
    assert not any(model.rolls(placement.pose) for placement in model.placements)


def test_a_can_on_its_side_rolls_at_every_angle():
    can = trimesh.creation.cylinder(0.03, 0.1, sections=24)
    model = ObjectModel("can", can, stable_placements(can))
    assert not any(model.rolls(placement.pose) for placement in model.placements)
    for angle in np.linspace(0, 1, 7):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xz", [np.pi / 2, angle]).as_matrix().T
        assert model.rolls(T)


@pytest.mark.parametrize(("name", "count"), [("tomatosoupcan", 2), ("pottedmeatcan", 6), ("banana", 2)])
def test_scans(name, count):
    path = SHARED / f"{name}.stl"
    if not path.exists():
        pytest.skip("the scanned objects are not here")
    assert len(load_object(path).placements) == count


def rocker(ratio, radius=0.1):
    """A block on a round base of 9 facets whose radius is `ratio` times the height of the centre of mass."""
    angle = np.deg2rad(np.arange(-45, 46, 10))
    arc = radius * np.column_stack([np.sin(angle), np.cos(angle[4]) - np.cos(angle)])

    def body(top):
        section = np.vstack([arc, arc[[0, -1]] + [0, top]])
        return trimesh.convex.convex_hull(np.vstack([np.insert(section, 1, y, axis=1) for y in (-0.03, 0.03)]))

    return body(brentq(lambda top: body(top).center_mass[2] * ratio - radius, 1e-3, 0.3))


@pytest.mark.parametrize(("ratio", "rests"), [(1.6, False), (1.95, False), (2.12, True), (2.9, True)])
def test_a_rocker_rests_where_a_fine_round_side_would_have_the_margin(ratio, rests):
    """Its strip of half width ``radius tan(pi / 64)`` is a tenth of the height at a radius of 2.04 heights."""
    upright = [p for p in stable_placements(rocker(ratio)) if p.pose[2, 2] > 0.999]
    assert len(upright) == rests
    if rests:  # its facets are 10 degrees wide
        assert upright[0].margin == pytest.approx(ratio * np.sin(np.deg2rad(5)), rel=1e-6)
