"""Scenes of workcells with meshes: a robot's mesh, obstacles of every kind, and a tool without fingers."""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from oracles.files import DATA

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.geometry.shapes import Box, Mesh
from regrasp_opt.motion.trajectory import scene_export
from regrasp_opt.motion.trajectory.scene_export import save_scene, xml_names
from regrasp_opt.scene import load_workcell

OBSTACLES = """
[[obstacles]]
type = "cylinder"
name = "post"
radius = 0.02
length = 0.3
position = [0.4, 0.5, 0.15]
[[obstacles]]
type = "mesh"
name = "part"
file = "part.stl"
position = [-0.4, 0.5, 0.1]
rpy = [0.0, 0.0, 0.5]
"""


@pytest.fixture
def plan(tmp_path, bottle_plan):
    """The plan of the bottle in a workcell whose robot has a mesh, beside a post and a mesh."""
    here = tmp_path / "files"
    here.mkdir()
    trimesh.creation.box((0.06, 0.06, 0.2)).export(here / "part.stl")
    trimesh.creation.cylinder(0.066, 0.035).export(here / "foot.stl")
    foot = '<cylinder radius="0.066" length="0.035"/>'
    urdf = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8")
    (here / "arm.urdf").write_text(urdf.replace(foot, '<mesh filename="foot.stl"/>'), encoding="utf-8")
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8").replace('"nova2"', '"arm.urdf"')
    (here / "cell.toml").write_text(text + OBSTACLES, encoding="utf-8")
    problem = replace(bottle_plan.problem, workcell=load_workcell(here / "cell.toml"))
    return replace(bottle_plan, problem=problem)


def bodies(path):
    """Return the collision bodies in a URDF by the names of their links, as Pinocchio reads it."""
    model = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION)
    return {item.name.rsplit("_", 1)[0]: item for item in geometry.geometryObjects}


def test_meshes_are_found_from_everywhere(plan, tmp_path, monkeypatch):
    folder = tmp_path / "scene"
    monkeypatch.chdir(tmp_path)
    save_scene(plan, "scene")
    monkeypatch.chdir("/")
    assert f'filename="{tmp_path / "files" / "foot.stl"}"' in (folder / "robot.urdf").read_text("utf-8")
    assert "base_link" in bodies(folder / "robot.urdf")
    fixed = bodies(folder / "surroundings.urdf")
    assert set(fixed) == {"table", "post", "part"}
    assert (fixed["post"].geometry.radius, 2 * fixed["post"].geometry.halfLength) == (0.02, 0.3)
    part = trimesh.load(folder / "surrounding-2.stl")
    (loose,) = bodies(folder / "object.urdf").values()
    corner = plan.problem.object.vertices.max(axis=0)
    np.testing.assert_allclose(loose.geometry.vertices().max(axis=0), corner, atol=1e-6)
    names = [m.get("filename") for file in folder.glob("*.urdf") for m in ET.parse(file).getroot().iter("mesh")]
    assert all(name.startswith("/") for name in names) and len(set(names)) == 3
    np.testing.assert_allclose(part.extents, [0.06, 0.06, 0.2], atol=1e-6)
    wanted = plan.problem.workcell.obstacles[1].pose
    np.testing.assert_allclose(fixed["part"].placement.homogeneous, wanted, atol=1e-9)


def test_names_of_packages_become_absolute_and_what_is_missing_is_left_out(plan, tmp_path, caplog):
    here = tmp_path / "files"
    (here / "meshes").mkdir()
    (here / "package.xml").write_text("<package><name>arm</name></package>", encoding="utf-8")
    for name in ("foot.stl", "part.stl"):
        (here / "meshes" / name).write_bytes((here / name).read_bytes())
    robot, lost = here / "arm.urdf", '<visual><geometry><mesh filename="package://gone/a.dae"/></geometry></visual>'
    seen = lost.replace("gone/a.dae", "arm/meshes/part.stl")
    text = robot.read_text("utf-8").replace('"foot.stl"', '"package://arm/meshes/foot.stl"')
    text = text.replace('<link name="link1">', f'<link name="link1">{lost}{seen}<xacro:left over="1"/>')
    robot.write_text(text.replace(' name="nova2"', ""), encoding="utf-8")
    save_scene(
        replace(plan, problem=replace(plan.problem, workcell=load_workcell(here / "cell.toml"))), tmp_path / "scene"
    )
    assert "mesh 'package://gone/a.dae' of" in caplog.text and "robot.urdf goes without it" in caplog.text
    root = ET.parse(tmp_path / "scene" / "robot.urdf").getroot()
    names = [mesh.get("filename") for mesh in root.iter("mesh")]
    assert set(names) == {str(here / "meshes" / "foot.stl"), str(here / "meshes" / "part.stl")}
    assert len(root.findall("link/visual")) == text.count("<visual>") - 1
    assert "base_link" in bodies(tmp_path / "scene" / "robot.urdf")


def test_a_suction_tool_has_no_fingers(tmp_path):
    problem = RegraspProblem.load("bottle", "nova2-s1")
    T = problem.pose(0, 0.1, 0.35)
    plan = solve_sequence(problem, T, T)
    assert plan.solved
    save_scene(plan, tmp_path)
    gripper = pin.buildModelFromUrdf(str(tmp_path / "gripper.urdf"))
    assert gripper.njoints == 1 and set(bodies(tmp_path / "gripper.urdf")) == {"gripper"}
    scene = json.loads((tmp_path / "scene.json").read_text("utf-8"))
    assert {held["grasp_id"] for held in scene["object_in_hand"]} == set(plan.transitions[0].grasp_ids.tolist())


def test_every_body_has_a_name_of_its_own_that_urdf_can_hold(bottle_plan, tmp_path):
    names = ["world", "a\x0bb", "a_b", "table_", "<&\"'>"]
    boxes = [Box(name, np.full(3, 0.05), translation(0.6, -0.2 - 0.1 * k, 0.1)) for k, name in enumerate(names)]
    problem = bottle_plan.problem.with_obstacles(boxes)
    save_scene(replace(bottle_plan, problem=problem), tmp_path)
    found = bodies(tmp_path / "surroundings.urdf")
    given = dict(zip(["world_", "a_b", "a_b_", "table_", "<&\"'>"], boxes, strict=True))
    assert set(found) == {"table", *given}
    for name, box in given.items():
        np.testing.assert_allclose(found[name].placement.homogeneous, box.pose, atol=1e-9)
    assert xml_names(["a", "a", "a_"], ["a_"]) == ["a", "a__", "a___"]


def test_meshes_of_a_gripper_stay_in_the_folder_whatever_they_are_called(bottle_plan, tmp_path):
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    body = [
        Mesh(name, np.array(box.vertices), np.array(box.faces), np.eye(4)) for name in ("../escaped", "object", "/")
    ]
    cell = bottle_plan.problem.workcell
    arm = replace(cell.arm, end_effector=replace(cell.arm.end_effector, body=tuple(body)))
    problem = replace(bottle_plan.problem, workcell=replace(cell, arm=arm))
    save_scene(replace(bottle_plan, problem=problem), tmp_path / "s")
    assert [path.name for path in tmp_path.iterdir()] == ["s"]
    root = ET.parse(tmp_path / "s" / "gripper.urdf").getroot()
    meshes = [mesh.get("filename") for mesh in root.iterfind("link/visual//mesh")]
    assert len(set(meshes)) == 3
    for name in meshes:
        np.testing.assert_allclose(trimesh.load(name).extents, box.extents, atol=1e-6)
    loose = trimesh.load(tmp_path / "s" / "object.stl")
    np.testing.assert_allclose(loose.extents, np.ptp(bottle_plan.problem.object.vertices, axis=0), atol=1e-6)


def test_an_interrupted_export_leaves_the_old_one(bottle_plan, tmp_path, monkeypatch):
    save_scene(bottle_plan, tmp_path)
    old = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(scene_export, "_write_mesh", interrupt)
    problem = bottle_plan.problem.with_obstacles([Box("crate", np.full(3, 0.1), translation(0.6, -0.4, 0.1))])
    with pytest.raises(KeyboardInterrupt):
        save_scene(replace(bottle_plan, problem=problem), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == old
