"""Models for MuJoCo, loaded and run by it: where everything is, what the jaw does, and where the object ends up."""

import csv
import runpy
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from oracles.files import DATA

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import OptionError, PlanFileError
from regrasp_opt.geometry.shapes import Mesh
from regrasp_opt.io import mjcf_export
from regrasp_opt.io.mjcf_export import convex_parts, save_mjcf
from regrasp_opt.io.ros_export import GRIP_FORCE
from regrasp_opt.motion import MotionPlan, MotionStatus, Phase, plan_motion, plan_with_motion
from regrasp_opt.motion.trajectory.jaw_events import Squeeze
from regrasp_opt.motion.trajectory.scene_export import DENSITY
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.scene import load_workcell

EXAMPLE = Path(__file__).parents[2] / "examples" / "09_replay_in_mujoco.py"
MIDDLE, CORNER = 5e-3, 5e-3
"""How far an object may be from where the plan has it after a replay: its origin, and its farthest vertex [m]."""

OBSTACLES = """
[[obstacles]]
type = "cylinder"
name = "../post"
radius = 0.02
length = 0.3
position = [0.4, 0.5, 0.15]
[[obstacles]]
type = "mesh"
name = "object"
file = "angle.stl"
position = [-0.45, 0.6, 0.05]
rpy = [0.0, 0.0, 0.5]
"""


@pytest.fixture(scope="module")
def replay():
    return runpy.run_path(str(EXAMPLE))["replay"]


@pytest.fixture(scope="module")
def folder(motion, tmp_path_factory):
    """Return the folder of the bottle's motion."""
    folder = tmp_path_factory.mktemp("mjcf") / "deep" / "model"
    save_mjcf(motion, folder)
    return folder


@pytest.fixture
def model(folder):
    return mujoco.MjModel.from_xml_path(str(folder / "model.xml"))


def pose(item):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = item.xmat.reshape(3, 3), item.xpos
    return T


def rows(folder):
    with (folder / "trajectory.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_arm_stands_where_ours_does_at_every_knot(motion, model):
    arm, data = motion.plan.problem.workcell.arm, mujoco.MjData(model)
    at = [model.joint(name).qposadr[0] for name in arm.robot.joint_names]
    for segment in motion.segments:
        for q in segment.trajectory.positions:
            data.qpos[at] = q
            mujoco.mj_kinematics(model, data)
            wanted = arm.T_world_base @ arm.robot.forward(q)
            np.testing.assert_allclose(pose(data.body("gripper")), wanted, rtol=0, atol=1e-9)
    low, high = model.jnt_range[[model.joint(name).id for name in arm.robot.joint_names]].T
    np.testing.assert_allclose([low, high], [arm.robot.lower, arm.robot.upper], atol=1e-12)


def test_the_keyframe_is_the_beginning(motion, model):
    data, plan, first = mujoco.MjData(model), motion.plan, motion.segments[0]
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(pose(data.body("object")), plan.poses[0], atol=1e-9)
    for number, T in enumerate(plan.poses):
        np.testing.assert_allclose(pose(data.site(f"pose{number}")), T, atol=1e-9)
    names = [model.actuator(number).name for number in range(model.nu)]
    assert names == [*plan.problem.workcell.arm.robot.joint_names, "jaw"]
    np.testing.assert_allclose(data.ctrl, [*first.trajectory.positions[0], first.jaw[0]], atol=1e-12)
    arm = plan.problem.workcell.arm
    for name, sign in (("left_finger", 1), ("right_finger", -1)):
        box = model.geom(model.body(name).geomadr[0])
        inner = box.pos[1] - sign * box.size[1] + sign * data.joint(f"{name}_joint").qpos[0]
        assert inner == pytest.approx(sign * first.jaw[0] / 2, abs=1e-9)
        assert box.size.tolist() == (arm.end_effector.finger[0].size / 2).tolist()


def test_the_object_has_the_mass_of_the_problem(motion, model):
    body, mesh = model.body("object"), motion.plan.problem.object.mesh
    assert body.mass[0] == pytest.approx(mesh.volume * DENSITY, rel=1e-9)
    np.testing.assert_allclose(body.ipos, mesh.center_mass, atol=1e-9)
    inertia = sorted(np.linalg.eigvalsh(mesh.moment_inertia * DENSITY))
    np.testing.assert_allclose(sorted(body.inertia), inertia, rtol=1e-6)


def test_a_force_that_was_given_is_that_of_the_model(motion, tmp_path):
    save_mjcf(replace(motion, squeeze=Squeeze(0.004, 25.0)), tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    assert model.actuator("jaw").forcerange.tolist() == [-25, 25]


def test_table_and_obstacles_stand_where_they_do(motion, tmp_path):
    """Obstacles of every kind; one has a name that no file can have, and another that of the object."""
    boxes = (trimesh.creation.box((0.2, 0.02, 0.1)), trimesh.creation.box((0.02, 0.2, 0.1)))
    angle = trimesh.boolean.union(boxes)
    angle.export(tmp_path / "angle.stl")
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
    (tmp_path / "cell.toml").write_text(text + OBSTACLES, encoding="utf-8")
    problem = replace(motion.plan.problem, workcell=load_workcell(tmp_path / "cell.toml"))
    save_mjcf(replace(motion, plan=replace(motion.plan, problem=problem)), tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    table, post, *parts = (k for k in range(model.ngeom) if model.geom_bodyid[k] == 0)
    np.testing.assert_allclose(2 * model.geom_size[table], problem.workcell.table.shape.size)
    np.testing.assert_allclose(data.geom_xpos[table], problem.workcell.table.shape.pose[:3, 3])
    assert model.geom_size[post, :2].tolist() == [0.02, 0.15]
    np.testing.assert_allclose(data.geom_xpos[post], [0.4, 0.5, 0.15])
    assert len(parts) > 1
    np.testing.assert_allclose(np.mean(data.geom_xpos[parts], axis=0), [-0.45, 0.6, 0.05], atol=0.02)
    files = {p for p in tmp_path.rglob("*") if p.is_file()}
    assert {p.parent for p in files} == {tmp_path, tmp_path / "out"} and len(files) == 2 + 2 + model.nmesh


def test_the_object_is_made_of_parts_that_are_nearly_it(motion):
    mesh = motion.plan.problem.object.mesh
    parts = convex_parts(mesh)
    assert len(parts) > 1 and all(part.is_convex for part in parts)
    assert sum(part.volume for part in parts) == pytest.approx(mesh.volume, rel=0.02)
    assert convex_parts(mesh.convex_hull) == [mesh.convex_hull]


def test_what_the_actuators_are_told_is_the_motion(motion, folder):
    told, robot = rows(folder), motion.plan.problem.workcell.arm.robot
    t = np.array([float(row["time"]) for row in told])
    assert t[0] == 0 and (np.diff(t) > 0).all() and t[-1] == pytest.approx(motion.duration, abs=1e-8)
    for row, time in zip(told, t, strict=True):
        k = int(np.searchsorted(motion.starts, time + 1e-7, side="right")) - 1
        segment, local = motion.segments[k], time - motion.starts[k]
        assert (row["phase"], int(row["transition"])) == (segment.phase.name.lower(), segment.transition)
        q = [float(row[name]) for name in robot.joint_names]
        np.testing.assert_allclose(q, segment.trajectory.at(local), atol=1e-7)
        if segment.phase.holds:
            assert float(row["jaw"]) == pytest.approx(segment.jaw[0] - motion.squeeze.below_contact, abs=1e-9)
        elif segment.phase not in (Phase.GRASP, Phase.RELEASE, Phase.REACH):
            assert float(row["jaw"]) == pytest.approx(segment.jaw[0], abs=1e-9)


def test_the_jaw_closes_evenly_and_presses_no_harder_than_it_may(motion, model):
    data, first = mujoco.MjData(model), motion.segments[0]
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    data.ctrl[-1] = 0.0
    for _ in range(2000):
        mujoco.mj_step(model, data)
        left, right = (data.joint(f"{side}_finger_joint").qpos[0] for side in ("left", "right"))
        assert abs(left - right) < 2e-4 and abs(data.actuator("jaw").force[0]) <= GRIP_FORCE + 1e-9
    assert left + right < 1e-3 < first.jaw[0]
    np.testing.assert_allclose(data.qpos[:6], first.trajectory.positions[0], atol=1e-3)  # and the arm does not sag


def test_a_replay_at_a_quarter_of_the_speed_places_the_bottle(motion, folder, replay):
    placed = replay(folder, 0.25)
    assert [p.number for p in placed] == list(range(1, len(motion.plan.poses)))
    reach = np.linalg.norm(motion.plan.problem.object.vertices, axis=1).max()
    assert max(p.offset for p in placed) < MIDDLE and max(p.offset + reach * p.angle for p in placed) < CORNER


def test_a_replay_at_a_quarter_of_the_speed_places_a_brick(tmp_path, replay):
    trimesh.creation.box((0.05, 0.09, 0.14)).export(tmp_path / "brick.stl")
    problem = RegraspProblem.load(tmp_path / "brick.stl", "nova2-w")
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    motion = plan_with_motion(problem, task.start, task.goal)
    save_mjcf(motion, tmp_path / "model")
    placed = replay(tmp_path / "model", 0.25)
    assert len(placed) >= 2
    reach = np.linalg.norm(problem.object.vertices, axis=1).max()
    assert max(p.offset for p in placed) < MIDDLE and max(p.offset + reach * p.angle for p in placed) < CORNER


def test_without_a_grip_nothing_is_carried(folder, tmp_path, replay):
    """The replay would see a jaw that does not close."""
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    text, limit = (folder / "model.xml").read_text("utf-8"), f'forcerange="-{GRIP_FORCE:g} {GRIP_FORCE:g}"'
    assert text.count(limit) == 1
    (tmp_path / "model.xml").write_text(text.replace(limit, 'forcerange="0 1"'), "utf-8")
    assert max(p.offset for p in replay(tmp_path, 1.0)) > 10 * MIDDLE


def test_a_cup_holds_by_its_vacuum(tmp_path, replay):
    trimesh.creation.box((0.05, 0.09, 0.14)).export(tmp_path / "brick.stl")
    problem = RegraspProblem.load(tmp_path / "brick.stl", "nova2-s1")
    motion = plan_motion(solve_sequence(problem, problem.pose(0, 0.1, 0.35), problem.pose(0, -0.15, 0.4, 1.0)))
    assert motion.solved, motion.reason
    save_mjcf(motion, tmp_path / "model")
    told = rows(tmp_path / "model")
    assert {row["vacuum"] for row in told if row["phase"] in ("lift", "transfer", "lower")} == {"1"}
    assert {row["vacuum"] for row in told if row["phase"] in ("reach", "approach", "retreat", "return")} == {"0"}
    (placed,) = replay(tmp_path / "model", 0.25)
    assert placed.offset < MIDDLE


def test_a_missing_package_and_no_motion_are_one_sentence(motion, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(OptionError, match=r"install regrasp-opt\[mujoco\]"):
        save_mjcf(motion, tmp_path / "model")
    unsolved = MotionPlan(MotionStatus.NO_MOTION, "blocked", motion.plan, (), *[np.ones(6)] * 2, 0.0)
    with pytest.raises(PlanFileError, match="blocked"):
        save_mjcf(unsolved, tmp_path / "model")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("failure", ["package", "interrupt"])
def test_a_failed_export_leaves_the_old_one(motion, folder, tmp_path, monkeypatch, failure):
    shutil.copytree(folder, tmp_path / "model")
    old = {path.name: path.read_bytes() for path in (tmp_path / "model").iterdir()}
    plate = trimesh.creation.box((0.3, 0.02, 0.3))
    shape = Mesh("plate", np.array(plate.vertices), np.array(plate.faces), translation(0.6, 0.8, 0.2))
    problem = motion.plan.problem.with_obstacles([shape])
    moved = replace(motion, plan=replace(motion.plan, problem=problem))

    def interrupt(*_):
        raise KeyboardInterrupt

    if failure == "package":
        monkeypatch.setitem(sys.modules, "coacd", None)
    else:
        monkeypatch.setattr(mjcf_export, "_write_trajectory", interrupt)
    with pytest.raises(OptionError if failure == "package" else KeyboardInterrupt):
        save_mjcf(moved, tmp_path / "model")
    assert {path.name: path.read_bytes() for path in (tmp_path / "model").iterdir()} == old


def test_links_and_joints_may_be_called_like_those_of_the_gripper(motion, tmp_path):
    urdf = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8")
    for old, new in (("link1", "gripper"), ("link2", "gripper_"), ("joint1", "jaw"), ("joint2", "time")):
        urdf = urdf.replace(f'"{old}"', f'"{new}"')
    (tmp_path / "arm.urdf").write_text(urdf, encoding="utf-8")
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8").replace('"nova2"', '"arm.urdf"')
    (tmp_path / "cell.toml").write_text(text, encoding="utf-8")
    problem = replace(motion.plan.problem, workcell=load_workcell(tmp_path / "cell.toml"))
    save_mjcf(replace(motion, plan=replace(motion.plan, problem=problem)), tmp_path / "model")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model" / "model.xml"))
    told = [model.actuator(number).name for number in range(model.nu)]
    assert told == ["jaw_", "time_", *problem.workcell.robot.joint_names[2:], "jaw"]
    assert list(rows(tmp_path / "model")[0]) == ["time", "transition", "phase", *told]
