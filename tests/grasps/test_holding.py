"""Whether grasps hold: what the sampler makes does, and every way of missing the object is found and named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import coal
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import translation
from regrasp_opt.end_effectors import EndEffector, load_end_effector
from regrasp_opt.end_effectors.model import Pad
from regrasp_opt.grasps import CONTACT_TOLERANCE, Failure, GraspSet, hold_failures, rejected_grasps, sample_grasps
from regrasp_opt.grasps.antipodal import FRICTION
from regrasp_opt.grasps.holding import GAP
from regrasp_opt.grasps.projection import GraspProjector
from regrasp_opt.objects import ObjectModel, load_object

SETS = [("bottle", "w"), ("bottle", "r140"), ("bottle", "r85"), ("bottle", "s1"), ("mug", "w"), ("mug", "s2")]
SETS += [("pentagon", "r85"), ("pentagon", "s3"), ("figurine", "r140"), ("figurine", "s3")]
W, S2 = load_end_effector("w"), load_end_effector("s2")
BRICK = ObjectModel("brick", trimesh.creation.box((0.04, 0.06, 0.08)), ())
PLATE = ObjectModel("plate", trimesh.creation.box((0.16, 0.16, 0.01)), ())
TIP = W.pad.z[1] - W.tcp_offset


@cache
def sampled(name: str, tool: str) -> tuple[ObjectModel, GraspSet]:
    model = load_object(name)
    return model, sample_grasps(model, load_end_effector(tool), 60, seed=5)


def moved(x: float = 0, y: float = 0, z: float = 0, axis: str = "x", degrees: float = 0) -> np.ndarray:
    T = translation(x, y, z)
    T[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return T


def failure(T: np.ndarray, width: float, model: ObjectModel = BRICK, tool: EndEffector = W) -> Failure | None:
    return hold_failures(GraspSet(T[None], [width], tool.kind), model, tool)[0]


@pytest.mark.parametrize(("name", "tool"), SETS)
def test_what_the_sampler_makes_holds(name: str, tool: str) -> None:
    model, grasps = sampled(name, tool)
    assert rejected_grasps(grasps, model, load_end_effector(tool)) == {}


@pytest.mark.parametrize("tool", ["w", "s1"])
def test_grasps_hold_in_single_precision_and_to_a_tenth_of_a_millimetre(tool: str) -> None:
    model, grasps = sampled("bottle", tool)
    single = GraspSet(grasps.T_object_tcp.astype(np.float32), grasps.width.astype(np.float32), grasps.kind)
    rounded = grasps.T_object_tcp.copy()
    rounded[:, :3, 3] = rounded[:, :3, 3].round(4)
    rounded[:, :3, :3] = rounded[:, :3, :3].round(5)
    for written in (single, GraspSet(rounded, grasps.width.round(4), grasps.kind)):
        assert hold_failures(written, model, load_end_effector(tool)) == [None] * len(grasps)


@pytest.mark.parametrize("name", ["bottle", "mug"])
@pytest.mark.parametrize("tool", ["w", "s2"])
def test_what_settles_holds(name: str, tool: str) -> None:
    model, effector, rng = load_object(name), load_end_effector(tool), np.random.default_rng(2)
    projector = GraspProjector(model, effector)
    T, _ = projector.anywhere(100, rng)
    T[:, :3, 3] += rng.normal(scale=0.005, size=(len(T), 3))
    settled, source = projector.settle(T, 2)
    assert len(settled) == len(source) >= 5
    assert rejected_grasps(settled, model, effector) == {}


@pytest.mark.parametrize("tool", ["w", "r140", "r85"])
def test_a_set_that_was_shifted_back_holds_nothing(tool: str) -> None:
    (model, grasps), effector = sampled("bottle", tool), load_end_effector(tool)
    back = GraspSet(grasps.T_object_tcp @ moved(z=-effector.tcp_offset), grasps.width, "parallel")
    assert set(hold_failures(back, model, effector)) <= {Failure.NOTHING_HELD, Failure.NOT_REACHED}


@pytest.mark.parametrize(
    ("T", "width", "expected"),
    [
        (moved(), 0.06, None),
        (moved(z=-0.103), 0.06, Failure.NOTHING_HELD),
        (moved(z=0.04 - TIP - 0.003), 0.06, None),  # the object's end, 3 mm on the tips of the pads
        (moved(z=0.04 + 0.002 - W.pad.z[0] + W.tcp_offset), 0.06, Failure.NOTHING_HELD),  # between palm and pads
        (moved(z=-0.04 - TIP - 0.001), 0.06, Failure.NOTHING_HELD),
        (moved(x=0.02 + 0.0125 - 0.003), 0.06, None),  # the object's edge, 3 mm on the sides of the pads
        (moved(x=0.02 + 0.0125 + 0.0005), 0.06, Failure.NOTHING_HELD),
        (moved(x=0.0285, z=-0.04 - TIP + 0.004), 0.06, None),  # the object's corner, 4 mm on a corner of the pads
        (moved(x=0.2), 0.06, Failure.NOTHING_HELD),
        (moved(y=0.09), 0.06, Failure.NOTHING_HELD),
        (moved(y=0.0009), 0.06, None),
        (moved(y=0.003), 0.06, Failure.NOT_REACHED),
        (moved(), 0.063, None),  # as wide as on a bumpy side
        (moved(), 0.064, Failure.NOT_REACHED),
        (moved(), 0.057, Failure.NOT_REACHED),
        (moved(y=0.01), 0.08, Failure.NOT_REACHED),  # one finger touches, the other closes on air
        (moved(axis="z", degrees=25), 0.06 / np.cos(np.deg2rad(25)), None),
        (moved(axis="z", degrees=28), 0.06 / np.cos(np.deg2rad(28)), Failure.SLIPS),
        (moved(axis="x", degrees=25), 0.06 / np.cos(np.deg2rad(25)), None),
        (moved(axis="x", degrees=28), 0.06 / np.cos(np.deg2rad(28)), Failure.SLIPS),
        (moved(axis="z", degrees=90), 0.04, None),
        (moved(axis="y", degrees=180), 0.06, None),
        (moved(), 0.0, Failure.NOT_REACHED),
        (moved(), 0.0941, Failure.TOO_WIDE),
    ],
)  # fmt: skip
def test_a_jaw_on_a_brick(T: np.ndarray, width: float, expected: Failure | None) -> None:
    assert failure(T, width) == expected


@pytest.mark.parametrize(("half_angle", "expected"), [(20, None), (30, Failure.SLIPS)])
def test_a_jaw_on_a_wedge(half_angle: float, expected: Failure | None) -> None:
    """A wedge with its edge along x slips out of the jaw where its faces are steeper than friction holds."""
    slope = np.tan(np.deg2rad(half_angle))
    corners = [(x, side * slope * 0.05, 0.05) for x in (-0.05, 0.05) for side in (-1, 1)]
    wedge = ObjectModel("wedge", trimesh.convex.convex_hull(np.array([*corners, (-0.05, 0, 0), (0.05, 0, 0)])), ())
    assert failure(moved(z=0.025), 2 * slope * 0.025, wedge) == expected


@pytest.mark.parametrize("beyond", [-0.06, -0.0333, -0.0047, 0.0, 0.0029, 0.0121, 0.0179])
@pytest.mark.parametrize("upright", [False, True])
def test_a_thin_card_is_held_by_its_edges(beyond: float, upright: bool) -> None:
    """A card of 1 mm touches a pad in a narrow strip, across its whole length or its whole width."""
    card = ObjectModel("card", trimesh.creation.box((0.05, 0.08, 0.001)), ())
    T = moved(axis="y", degrees=90) if upright else moved()
    assert failure(T @ translation(0, 0, -beyond), 0.08, card) is None


def test_a_thin_card_beside_the_middle_of_the_pad_is_held_at_the_height_of_the_tcp() -> None:
    card = ObjectModel("card", trimesh.creation.box((0.001, 0.08, 0.01)), ())
    assert failure(moved(x=0.0022), 0.08, card) is None
    assert failure(moved(x=0.2), 0.08, card) == Failure.NOTHING_HELD


def test_a_slot_does_not_hold_the_fingers_in_its_walls() -> None:
    """The walls of a slot face each other, not the pads, whatever the width."""
    block, slot = trimesh.creation.box((0.04, 0.06, 0.04)), trimesh.creation.box((0.06, 0.001, 0.03))
    slot.apply_translation([0, 0, -0.02])
    slotted = ObjectModel("slotted", trimesh.boolean.difference([block, slot], engine="manifold"), ())
    for width in (0.0, 0.001, 0.002, 0.003):
        assert failure(moved(z=-0.02 - TIP + 0.02), width, slotted) in (Failure.SLIPS, Failure.NOT_REACHED)


def test_a_contact_on_the_finger_but_beside_the_pad_does_not_hold() -> None:
    tip = replace(W, pad=Pad((-0.0125, 0.0125), (0.17, 0.1785)))
    for tool, expected in ((W, None), (tip, Failure.NOTHING_HELD)):
        assert failure(moved(z=-0.04 - 0.015), 0.06, tool=tool) is None  # the brick begins 15 mm beyond the TCP
        assert failure(moved(z=0.04 - 0.005), 0.06, tool=tool) == expected  # and ends 5 mm beyond it


@pytest.mark.parametrize("z", [(0.086, 0.092), (0.1735, 0.1785), (0.12, 0.14)])
def test_grasps_are_sampled_for_the_pad(z: tuple[float, float]) -> None:
    tool = replace(W, pad=Pad((-0.005, 0.005), z))
    grasps = sample_grasps(BRICK, tool, 20, seed=1)
    assert rejected_grasps(grasps, BRICK, tool) == {}


def test_a_mug_is_not_held_where_only_its_wall_is_between_the_fingers() -> None:
    model, grasps = sampled("mug", "w")
    wall = grasps.subset(grasps.width < 0.01)
    assert len(wall)
    across = GraspSet(wall.T_object_tcp, wall.width + 0.03, "parallel")
    assert set(hold_failures(across, model, W)) == {Failure.NOT_REACHED}


@pytest.mark.parametrize(
    ("x", "z", "tilt", "expected"),
    [
        (0.0, 0.0, 0, None),
        (0.08 - 0.0125 - 0.0002, 0.0, 0, None),
        (0.08 - 0.0125 + 0.0002, 0.0, 0, Failure.LEAKS),
        (0.079, 0.0, 0, Failure.LEAKS),  # half over the edge
        (0.1, 0.0, 0, Failure.NO_CONTACT),
        (0.0, 0.0009, 0, None),
        (0.0, 0.0012, 0, Failure.NO_CONTACT),  # in the air
        (0.0, -0.0012, 0, Failure.NO_CONTACT),  # in the plate
        (0.0, 0.0, 5, None),
        (0.0, 0.0, 11, Failure.TILTED),
        (0.0, 0.0, 20, Failure.LEAKS),
        (0.0, 0.0, 90, Failure.NO_CONTACT),
        (0.0, 0.0, 180, Failure.NO_CONTACT),  # from inside
    ],
)
@pytest.mark.parametrize("yaw", [0, 50])
def test_a_cup_on_a_plate(x: float, z: float, tilt: float, yaw: float, expected: Failure | None) -> None:
    T = moved(x=x, z=0.005 + z, axis="x", degrees=180 + tilt) @ moved(axis="z", degrees=yaw)
    assert failure(T, 0.0, PLATE, S2) == expected


def test_turned_cups_on_one_spot_are_told_apart_from_others() -> None:
    T = np.array([moved(x=x, z=0.005, axis="x", degrees=180) for x in (0.0, 0.079, 0.0, 0.02)])
    T[2] = T[2] @ moved(axis="z", degrees=30)
    found = hold_failures(GraspSet(T, np.zeros(4), "suction"), PLATE, S2)
    assert found == [None, Failure.LEAKS, None, None]


def test_none_of_no_grasps_fails() -> None:
    assert hold_failures(GraspSet([], [], "parallel"), BRICK, W) == []
    assert hold_failures(GraspSet([], [], "suction"), PLATE, S2) == []


@pytest.mark.parametrize("name", ["bottle", "mug", "figurine"])
def test_other_eyes_find_contacts_wherever_a_grasp_is_said_to_hold(name: str) -> None:
    """Coal finds, at both pads of grasps that were moved at random, triangles inside the friction cones."""
    model, grasps = sampled(name, "w")
    rng = np.random.default_rng(4)
    moves = np.tile(np.eye(4), (len(grasps), 1, 1))
    moves[:, :3, :3] = Rotation.from_rotvec(rng.normal(scale=0.2, size=(len(grasps), 3))).as_matrix()
    moves[:, :3, 3] = rng.normal(scale=0.004, size=(len(grasps), 3))
    tried = GraspSet(grasps.T_object_tcp @ moves, grasps.width, "parallel")
    held = [found is None for found in hold_failures(tried, model, W)]
    seen = [_contacts_seen(model, T, width) for T, width in zip(tried.T_object_tcp, tried.width, strict=True)]
    assert 3 <= sum(held) < len(held) and not (np.array(held) & ~np.array(seen)).any()


def _contacts_seen(model: ObjectModel, T: np.ndarray, width: float) -> bool:
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(model.faces), len(model.vertices))
    for a, b, c in model.vertices[model.faces]:
        surface.addTriangle(a, b, c)
    surface.endModel()
    size = [W.pad.x[1] - W.pad.x[0], GAP + CONTACT_TOLERANCE, W.pad.z[1] - W.pad.z[0]]
    request = coal.CollisionRequest(coal.CONTACT, 10_000)
    for side in (-1.0, 1.0):
        middle = side * (width / 2 + (CONTACT_TOLERANCE - GAP) / 2)
        pose = T @ translation(0.0, middle, sum(W.pad.z) / 2 - W.tcp_offset)
        result = coal.CollisionResult()
        placed = coal.Transform3s(pose[:3, :3], pose[:3, 3])
        coal.collide(surface, coal.Transform3s(), coal.Box(*size), placed, request, result)
        normals = model.mesh.face_normals[[contact.b1 for contact in result.getContacts()]]
        if not (side * normals.reshape(-1, 3) @ T[:3, 1] >= np.cos(np.arctan(FRICTION)) - 1e-3).any():
            return False
    return True
