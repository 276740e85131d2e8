"""Grasps that the table leaves room for: sampled for every placement, down to what fingertips can reach."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from regrasp_opt.conventions import FloatArray
from regrasp_opt.end_effectors import EndEffector, load_end_effector
from regrasp_opt.errors import GraspError
from regrasp_opt.geometry.shapes import surface_points
from regrasp_opt.grasps import GraspSet, rejected_grasps, sample_grasps
from regrasp_opt.grasps.table import TableRoom
from regrasp_opt.objects import ObjectModel, load_object
from regrasp_opt.objects.placements import stable_placements


def solid(mesh: trimesh.Trimesh, name: str = "part") -> ObjectModel:
    return ObjectModel(name, mesh, stable_placements(mesh))


def lowest(grasps: GraspSet, tool: EndEffector, T_world_object: FloatArray) -> FloatArray:
    """Return the height of the lowest corner of the gripper above the table at a placement (G,) [m]."""
    flange = T_world_object @ grasps.T_object_tcp @ tool.T_tcp_flange
    heights = []
    for T, width in zip(flange, grasps.width.tolist(), strict=True):
        shapes = (*tool.body, *tool.finger_boxes(width, tool.pre_opening))
        corners = np.concatenate([surface_points(shape) for shape in shapes])
        heights.append((corners @ T[2, :3]).min() + T[2, 3])
    return np.array(heights)


def usable(grasps: GraspSet, tool: EndEffector, model: ObjectModel, clearance: float = 0.003) -> FloatArray:
    """Return in which placements (G, S) the gripper stays clear of the table."""
    return np.stack([lowest(grasps, tool, placement.pose) >= clearance for placement in model.placements], axis=1)


FLAT = {
    "bar": lambda: trimesh.creation.box((0.15, 0.02, 0.008)),
    "ring": lambda: trimesh.creation.torus(0.05, 0.006, major_sections=48, minor_sections=24),
    "tile": lambda: trimesh.creation.box((0.06, 0.05, 0.006)),
}


@pytest.mark.parametrize("name", ["w", "r140", "s2"])
def test_room_is_the_height_of_the_lowest_corner(name: str) -> None:
    tool, model = load_end_effector(name), load_object("mug")
    grasps = sample_grasps(model, tool, 40, seed=4)
    tilted = grasps.T_object_tcp.copy()
    tilted[:, :3, :3] = tilted[:, :3, :3] @ np.linalg.qr(np.random.default_rng(0).normal(size=(40, 3, 3)))[0]
    tilted[np.linalg.det(tilted[:, :3, :3]) < 0, :3, 2] *= -1
    turned = GraspSet(tilted, grasps.width, grasps.kind)
    room = TableRoom.of(model, tool, 0.01)
    expected = np.stack([lowest(turned, tool, p.pose) for p in model.placements], axis=1) - 0.01
    np.testing.assert_allclose(room.heights(tilted, grasps.width), expected, atol=2e-6)
    only = np.arange(len(model.placements)) == 1
    np.testing.assert_array_equal(
        room.among(only).heights(tilted, grasps.width), room.heights(tilted, grasps.width)[:, only]
    )


@pytest.mark.parametrize("name", ["w", "r85", "r140"])
@pytest.mark.parametrize("flat", FLAT)
def test_flat_objects_are_grasped_as_they_lie(flat: str, name: str) -> None:
    model, tool = solid(FLAT[flat]()), load_end_effector(name)
    grasps = sample_grasps(model, tool, 60, seed=1)
    clear = usable(grasps, tool, model)
    assert clear.any(axis=1).mean() > 0.9
    assert clear.sum(axis=0).min() >= 60 / 4 / len(model.placements)
    assert rejected_grasps(grasps, model, tool) == {}


@pytest.mark.parametrize("name", ["w", "s1"])
@pytest.mark.parametrize("built_in", ["bottle", "mug", "pentagon"])
def test_grasps_are_of_use_in_some_placement_and_each_gets_its_share(built_in: str, name: str) -> None:
    model, tool = load_object(built_in), load_end_effector(name)
    clear = usable(sample_grasps(model, tool, 80, seed=2), tool, model)
    assert clear.any(axis=1).all()
    assert clear.sum(axis=0).min() >= 80 / 4 / len(model.placements)


def test_how_thin_an_object_may_be_depends_on_the_clearance() -> None:
    tool, sheet = load_end_effector("w"), solid(trimesh.creation.box((0.06, 0.05, 0.003)))
    apart, near = (sample_grasps(sheet, tool, 40, clearance=least) for least in (0.003, 0.001))
    assert not usable(apart, tool, sheet).any()
    assert usable(near, tool, sheet, 0.001).any(axis=1).mean() > 0.9


@pytest.mark.parametrize(("thickness", "near_the_tip"), [(0.06, False), (0.006, True)])
def test_pads_overlap_by_less_than_4_mm_only_where_the_table_asks_for_it(thickness: float, near_the_tip: bool) -> None:
    tool, model = load_end_effector("w"), solid(trimesh.creation.box((0.06, 0.05, thickness)))
    grasps = sample_grasps(model, tool, 200)
    upright = [placement.pose[2, 2] > 0.999 for placement in model.placements]
    T = grasps.T_object_tcp[usable(grasps, tool, model)[:, upright].any(axis=1)]
    tip = T[T[:, 2, 2] < -0.999, 2, 3] - (tool.pad.z[1] - tool.tcp_offset)
    overlap = thickness / 2 - tip
    assert len(overlap) > 2
    assert (overlap < 0.004).all() if near_the_tip else (overlap >= 0.004 - 1e-6).all()


def test_a_plate_wider_than_the_jaw_still_has_grasps_by_its_rim() -> None:
    """The table rules them all out; a person who holds the plate, or a table's edge, does not."""
    model, tool = solid(trimesh.creation.box((0.2, 0.15, 0.006))), load_end_effector("w")
    grasps = sample_grasps(model, tool, 50)
    assert len(grasps) == 50 and not usable(grasps, tool, model).any()
    assert grasps.width.max() < 0.01


def test_an_object_of_which_little_seals_is_refused_after_a_thousand_points() -> None:
    needle = solid(trimesh.creation.box((0.01, 0.01, 0.15)), "needle")
    with pytest.raises(GraspError, match="'s1' fits object 'needle'"):
        sample_grasps(needle, load_end_effector("s1"))
