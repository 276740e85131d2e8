"""Where bodies are and how far apart, beside Coal and the package: meshes, capsules, posts, locked joints."""

from importlib.metadata import distribution
from pathlib import Path

import coal
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oracles.cells import FOREIGN, OWN, write_cell
from oracles.files import Cell, Shape, Tool, read_cell, read_urdf
from oracles.plans import PlanVerifier
from oracles.world import World
from regrasp_opt.objects import load_object
from regrasp_opt.robots import load_robot
from regrasp_opt.scene import FURTHER_WORKCELL_NAMES, load_workcell

ROBOTS = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
ONE_JOINT = """<robot name="r"><link name="world"/><link name="a"/><joint name="j" type="continuous">
<parent link="world"/><child link="a"/><axis xyz="0 0 1"/></joint></robot>"""


CHANGED = """schema = 1
[robot]
model = "{}"
tip = "panda_link7"
tip_position = [0.01, 0.02, 0.1]
tip_rpy = [0.1, 0.2, 0.3]
leave_out = ["panda_link8"]
locked = {{ panda_joint3 = 0.4 }}
srdf = "arm.srdf"
home = [0.0, -0.785, -2.356, 0.0, 1.571, 0.785]
[end_effector]
model = "w"
[table]
height = -1.0
center = [0.0, 0.0]
size = [1.0, 1.0]
[workspace]
x = [-0.2, 0.2]
y = [-0.2, 0.2]
"""


def mesh_of(name):
    body = load_object(name)
    return np.array(body.vertices), np.array(body.faces)


def world_with(tmp_path, obstacles):
    (tmp_path / "r.urdf").write_text(ONE_JOINT, encoding="utf-8")
    robot = read_urdf(tmp_path / "r.urdf", "a")
    tool = Tool("suction", 0.1, 0.0, 0.01, 0.0, [], [], None)
    return World(Cell(None, np.eye(4), robot, tool, [], obstacles, {}), *mesh_of("mug"))


def bvh(vertices, faces):
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addVertices(vertices)
    model.addTriangles(faces)
    model.endModel()
    return model


@pytest.mark.parametrize("kind", ["figurine", "mug", "box", "cylinder"])
def test_distances_of_a_mug_are_those_of_coal(tmp_path, kind):
    """Handles, hollows and all: to 2 micrometres apart, and the same pairs overlap."""
    if kind in ("figurine", "mug"):
        shape, other = Shape("part", "mesh", np.eye(4), None, *mesh_of(kind)), bvh(*mesh_of(kind))
    elif kind == "box":
        shape, other = Shape("part", "box", np.eye(4), (0.02, 0.03, 0.1)), coal.Box(0.02, 0.03, 0.1)
    else:
        shape, other = Shape("part", "cylinder", np.eye(4), (0.012, 0.1)), coal.Cylinder(0.012, 0.1)
    world = world_with(tmp_path, [shape])
    mug, thing, part = bvh(*mesh_of("mug")), world.index["object"], world.index["part"]
    rng, overlaps = np.random.default_rng(0), 0
    for _ in range(60):
        T = np.eye(4)
        T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        T[:3, 3] = rng.uniform(-0.09, 0.09, 3)
        world.place(np.zeros(1), T, 0.0, 0.0)
        there, here = coal.Transform3s(T[:3, :3], T[:3, 3]), coal.Transform3s()
        expected = coal.distance(mug, there, other, here, coal.DistanceRequest(), coal.DistanceResult())
        found = world.distance(thing, part, 1.0)
        if expected > 0:
            assert found == pytest.approx(expected, abs=3e-6) or found == -1.0  # wholly inside
            assert min(world.distance(thing, part, 0.01), 0.01) == pytest.approx(min(found, 0.01), abs=1e-9)
        else:
            overlaps += 1
            assert found < 1e-6
            assert world.distance(thing, part, 1e-4, -1e-4) < -1e-4 or found >= -1e-4  # no early end at a shallow one
    assert overlaps > 5


@pytest.mark.parametrize("name", FOREIGN)
def test_arms_of_others_stand_where_the_package_puts_them(name):
    path, tip, _ = FOREIGN[name]
    robot, mine = load_robot(ROBOTS / path, tip=tip), read_urdf(ROBOTS / path, tip)
    assert tuple(mine.joints) == robot.joint_names
    bounded = np.isfinite(mine.limits).all(axis=1)
    np.testing.assert_allclose(mine.limits[bounded], np.stack([robot.lower, robot.upper], axis=1)[bounded])
    tool = Tool("suction", 0.1, 0.0, 0.01, 0.0, [], [], None)
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix(), (0.3, 0.2, 0.1)
    world = World(Cell(None, base, mine, tool, [], [], {}), *mesh_of("pentagon"))
    for q in np.random.default_rng(0).uniform(-1, 1, (5, robot.dof)):
        np.testing.assert_allclose(world.place(q, None, 0.0, 0.0), base @ robot.forward(q), atol=1e-12)


@pytest.mark.parametrize("name", FURTHER_WORKCELL_NAMES)
def test_built_in_arms_of_others_stand_where_the_package_puts_them(name):
    """With what their files leave out, and their tools on the seats that these state."""
    cell, theirs = load_workcell(name), read_cell({"source": "built-in", "name": name})
    assert tuple(theirs.robot.joints) == cell.robot.joint_names
    world = World(theirs, *mesh_of("pentagon"))
    links = [body.link for body in world.bodies if body.link]
    assert sorted(links) == sorted(cell.robot.link_of(i) for i in range(cell.robot.collision.ngeoms))
    for q in [
        cell.robot.home,
        *np.random.default_rng(0).uniform(cell.robot.lower, cell.robot.upper, (5, len(cell.robot.home))),
    ]:
        np.testing.assert_allclose(world.place(q, None, 0.0, 0.0), cell.T_world_base @ cell.robot.forward(q), atol=1e-9)


def test_what_a_workcell_says_of_its_robot_is_read_alike(tmp_path):
    (tmp_path / "arm.srdf").write_text('<robot><disable_collisions link1="a" link2="b"/></robot>', encoding="utf-8")
    (tmp_path / "cell.toml").write_text(
        CHANGED.format(Path(load_robot("panda").urdf_path).as_posix()), encoding="utf-8"
    )
    robot, theirs = load_workcell(tmp_path / "cell.toml").robot, read_cell({"source": str(tmp_path / "cell.toml")})
    assert tuple(theirs.robot.joints) == robot.joint_names and len(robot.joint_names) == 6
    assert frozenset(("a", "b")) in theirs.ignored
    world = World(theirs, *mesh_of("pentagon"))
    for q in np.random.default_rng(0).uniform(robot.lower, robot.upper, (5, robot.dof)):
        np.testing.assert_allclose(world.place(q, None, 0.0, 0.0), robot.forward(q), atol=1e-9)


@pytest.mark.parametrize("name", OWN)
def test_what_stands_still_in_a_urdf_is_an_obstacle(name, tmp_path):
    cell = read_cell({"source": str(write_cell(name, tmp_path)), "name": name})
    verifier = PlanVerifier(None, cell, mesh_of("pentagon"))
    bodies = verifier.world.bodies
    still = {body.link for body in bodies if body.part == "fixed"}
    assert still == {"posts": {"left post", "right post"}, "shelf": {"shelf"}}.get(
        name, {"torso", "head", "left arm", "left hand"}
    )
    tested = {(bodies[a].link or bodies[a].name, bodies[b].link or bodies[b].name) for a, b, _, _ in verifier.pairs}
    tested |= {pair[::-1] for pair in tested}
    for link in still:
        assert ("l1", link) in tested and ("gripper palm", link) in tested and ("object", link) in tested
    assert (cell.robot.seat, "l1") not in tested and (cell.robot.seat, "l2") in tested
    assert ("l1", "l2") not in tested and ("l1", "l3") in tested and ("l6", "gripper palm") not in tested
