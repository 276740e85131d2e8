"""The collision world: where its bodies are, and which pairs a phase tests at which clearance."""

from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt.geometry.shapes import Box
from regrasp_opt.objects import load_object
from regrasp_opt.scene import Clearance, load_workcell
from regrasp_opt.scene.collision_world import CollisionWorld, ContactPhase


@pytest.fixture(scope="module")
def cell():
    cell = load_workcell("nova2-w")
    pose = np.eye(4)
    pose[:3, 3] = 0.3, 0.5, 0.1
    turned = np.array([[0, -1, 0, 0.2], [1, 0, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1.0]])
    return replace(
        cell,
        arm=replace(cell.arm, T_world_base=turned),
        obstacles=(Box("crate", np.array([0.1, 0.1, 0.2]), pose),),
        clearance=Clearance(arm=0.005, gripper=0.003, self_collision=0.001),
    )


@pytest.fixture(scope="module")
def world(cell):
    return CollisionWorld(cell, load_object("bottle"))


def kinds(world, phase):
    """Return the pairs of a phase as pairs of kinds with their clearances."""
    groups = {
        "arm": world.moving, "base": world.still, "gripper": world.gripper, "support": world.supports,
        "obstacle": world.obstacles, "object": (world.object,),
    }  # fmt: skip
    kind = {index: name for name, group in groups.items() for index in group}
    return {(kind[i], kind[j], clearance) for i, j, clearance in world.pairs(phase)}


SURROUNDINGS = {
    ("arm", "support", 0.005), ("arm", "obstacle", 0.005), ("gripper", "support", 0.003),
    ("gripper", "obstacle", 0.003), ("gripper", "arm", 0.001), ("gripper", "base", 0.001), ("arm", "arm", 0.001),
    ("base", "arm", 0.001),
}  # fmt: skip
HELD = {("object", "arm", 0.005), ("object", "base", 0.003), ("object", "obstacle", 0.003)}


def test_what_stands_still_is_where_the_workcell_says(cell, world):
    (crate,), items = world.obstacles, cell.robot.collision.geometryObjects
    np.testing.assert_allclose(world.bodies[crate].pose[:3, 3], [0.3, 0.5, 0.1])
    assert [items[i].parentJoint for i in world.still] == [0] * len(world.still) and world.still
    for i in world.still:
        np.testing.assert_allclose(world.bodies[i].pose, cell.T_world_base @ items[i].placement.homogeneous)


@pytest.mark.parametrize(
    ("phase", "expected"),
    [
        (ContactPhase.GRASP, SURROUNDINGS | {("arm", "object", 0.005)}),
        (ContactPhase.MOVE, SURROUNDINGS | {("arm", "object", 0.005), ("gripper", "object", 0.0)}),
        (ContactPhase.LIFT, SURROUNDINGS | HELD),
        (ContactPhase.CARRY, SURROUNDINGS | HELD | {("object", "support", 0.003)}),
        (ContactPhase.REST, {("object", "base", 0.003), ("object", "obstacle", 0.003)}),
    ],
)
def test_a_phase_says_who_may_touch_whom(world, phase, expected):
    assert kinds(world, phase) == expected
    pairs = [(i, j) for i, j, _ in world.pairs(phase)]
    assert len(set(map(frozenset, pairs))) == len(pairs)


def test_the_last_link_may_touch_the_tool_and_what_it_holds(cell, world):
    last = {i for i in world.moving if world.bodies[i].joint == cell.robot.dof}
    assert last
    for phase in ContactPhase:
        partners = {j for i, j, _ in world.pairs(phase) if i in (*world.gripper, world.object)}
        assert not partners & last


def test_at_home_the_surroundings_need_only_be_apart(world):
    clearances = {
        clearance for _, j, clearance in world.pairs(ContactPhase.HOME) if j in (*world.supports, *world.obstacles)
    }
    assert clearances == {0.0} and world.object not in {i for pair in world.pairs(ContactPhase.HOME) for i in pair[:2]}


@pytest.mark.parametrize(
    ("shorter", "longer"), [(ContactPhase.GRASP, ContactPhase.MOVE), (ContactPhase.LIFT, ContactPhase.CARRY)]
)
def test_a_phase_begins_with_the_pairs_of_the_one_it_adds_to(world, shorter, longer):
    pairs = world.pairs(shorter)
    assert world.pairs(longer)[: len(pairs)] == pairs and len(world.pairs(longer)) > len(pairs)
