"""The certificate of a plan sees every kind of collision: each is put into a true plan, and both bodies are named."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from regrasp_opt.conventions import invert, translation
from regrasp_opt.geometry.shapes import Box, surface_points
from regrasp_opt.scene import Support

SIZE = np.full(3, 0.01)


@pytest.fixture(scope="module")
def held(plan):
    """Return the plan with one grasp in its first transition and none in the others."""
    first = plan.transitions[0]
    one = replace(
        first, grasp_ids=first.grasp_ids[:1], q_pick=first.q_pick[:1], q_place=first.q_place[:1],
        clearance=first.clearance[:1],
    )  # fmt: skip
    return replace(plan, transitions=(one,))


@pytest.fixture(scope="module")
def places(held):
    """Return where bodies are in the world at the pick: arm bodies by name, and the flange."""
    cell, q = held.problem.workcell, held.transitions[0].q_pick[0]
    frames = [np.eye(4), *cell.robot.link_transforms(q)]
    items = cell.robot.collision.geometryObjects
    found = {item.name: cell.T_world_base @ frames[item.parentJoint] @ item.placement.homogeneous for item in items}
    return {**found, "flange": cell.T_world_base @ cell.robot.forward(q)}


def with_cell(plan, **changes):
    return replace(plan, problem=replace(plan.problem, workcell=replace(plan.problem.workcell, **changes)))


def with_crate(plan, center):
    return with_cell(plan, obstacles=(Box("crate", SIZE, translation(*center)),))


def with_part_of_the_object(plan, center):
    """Return the plan with a small cube at `center` in the world that belongs to the object at its first pose."""
    body = plan.problem.object
    cube = trimesh.creation.box(SIZE, invert(plan.poses[0]) @ translation(*center))
    mesh = trimesh.util.concatenate([trimesh.Trimesh(body.vertices, body.faces, process=False), cube])
    return replace(plan, problem=replace(plan.problem, object=replace(body, mesh=mesh)))


def with_part_of_the_gripper(plan, T_world_flange, center):
    effector = plan.problem.workcell.end_effector
    stick = Box("stick", SIZE, invert(T_world_flange) @ translation(*center))
    effector = replace(effector, body=(*effector.body, stick))
    return with_cell(plan, arm=replace(plan.problem.workcell.arm, end_effector=effector))


def pick_problem(plan):
    """Return the two bodies that the verification names as nearest at the pick, and assert that it refuses the plan."""
    residuals = plan.residuals()
    certificate = residuals.transitions[0]
    assert certificate.collision_margin[0, 0] < -1e-4
    assert any("at its pick: bodies are" in text and "nearer than" in text for text in residuals.problems)
    return set(certificate.nearest[0])


def on_finger(plan, T_world_flange, opening, depth):
    """Return a point of the +y finger, opened by `opening` more, `depth` below its outer face, near the palm."""
    grasp = plan.transitions[0].grasp_ids[0]
    finger = plan.problem.workcell.end_effector.finger_boxes(float(plan.problem.grasps.width[grasp]) + opening)[0]
    local = finger.pose[:3, 3] + [0.0, finger.size[1] / 2 - depth, -0.4 * finger.size[2]]
    return T_world_flange[:3, :3] @ local + T_world_flange[:3, 3]


def test_the_plan_itself_is_free(held):
    certificate = held.residuals().transitions[0]
    assert certificate.collision_margin.min() >= -1e-4 and "crate" not in {
        name for pair in certificate.nearest for name in pair
    }


@pytest.mark.parametrize("link", ["link2_1", "link3_1", "link5_1"])
def test_an_obstacle_in_a_link(held, places, link):
    pair = pick_problem(with_crate(held, places[link][:3, 3]))
    assert "crate" in pair and any(name.startswith(link[:5]) for name in pair)


@pytest.mark.parametrize("opened", [True, False], ids=["opened", "closed"])
def test_an_obstacle_in_a_finger_as_it_approaches_or_holds(held, places, opened):
    effector = held.problem.workcell.end_effector
    opening, depth = (2 * effector.pre_opening, 5e-4) if opened else (0.0, effector.finger[0].size[1] - 5e-4)
    crate = Box("crate", np.full(3, 1e-3), places["flange"].copy())
    crate.pose[:3, 3] = on_finger(held, places["flange"], opening, depth)
    assert pick_problem(with_cell(held, obstacles=(crate,))) == {"gripper finger+y", "crate"}


def test_an_obstacle_at_the_object(held):
    T, body = held.poses[0], held.problem.object
    vertices = body.vertices @ T[:3, :3].T + T[:3, 3]
    flange = held.problem.workcell.robot.forward(held.transitions[0].q_pick[0])[:3, 3]
    farthest = vertices[np.argmax(np.linalg.norm(vertices - flange, axis=1))]
    assert pick_problem(with_crate(held, farthest)) == {"object", "crate"}


def test_the_table_in_the_gripper(held, places):
    effector = held.problem.workcell.end_effector
    points = np.concatenate([surface_points(s) for s in (*effector.body, *effector.finger_boxes(0.0))])
    lowest = (points @ places["flange"][2, :3] + places["flange"][2, 3]).min()
    table = held.problem.workcell.table
    table = replace(table, T_world_support=translation(*table.center, float(lowest) + 0.005))
    pair = pick_problem(with_cell(held, supports=(table,)))
    assert "table" in pair and any(name.startswith("gripper") for name in pair)


def test_the_table_in_a_link(held, places):
    x, y, z = places["link3_1"][:3, 3]
    pillar = Support.table(z + 0.005, np.array([x, y]), np.array([0.01, 0.01]), 0.01)
    pair = pick_problem(with_cell(held, supports=(pillar,)))
    assert "table" in pair and any(name.startswith("link3") for name in pair)


@pytest.mark.parametrize("name", ["base_link_0", "link3_1", "palm"])
def test_the_object_in_the_robot(held, places, name):
    palm = places["flange"] @ held.problem.workcell.end_effector.body[0].pose
    center = palm[:3, 3] if name == "palm" else places[name][:3, 3]
    pair = pick_problem(with_part_of_the_object(held, center))
    assert "object" in pair and any(name[:5] in other for other in pair - {"object"})


def test_the_object_in_the_open_finger(held, places):
    effector = held.problem.workcell.end_effector
    outside = on_finger(held, places["flange"], 2 * effector.pre_opening, 0.0)
    assert pick_problem(with_part_of_the_object(held, outside)) == {"gripper finger+y", "object"}


def test_the_gripper_in_a_link(held, places):
    pair = pick_problem(with_part_of_the_gripper(held, places["flange"], places["link3_1"][:3, 3]))
    assert "gripper stick" in pair and any(name.startswith("link3") for name in pair)


def test_two_links_in_each_other(held):
    robot = held.problem.workcell.robot
    folded = np.array([0.0, 0.0, 2.6, 1.5, 0.0, 0.0])
    assert robot.within_limits(folded)
    first = replace(held.transitions[0], q_pick=folded[None])
    pair = pick_problem(replace(held, transitions=(first,)))
    assert all("link" in name for name in pair) and len({name.split("_")[0] for name in pair}) == 2
