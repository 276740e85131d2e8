"""Motions as files: what is written is read back, and nothing malformed is believed."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from oracles.motions import verify_motion

from regrasp_opt.errors import OptionError, PlanFileError
from regrasp_opt.motion import MotionPlan, MotionStatus, Phase, Squeeze
from regrasp_opt.motion.trajectory import motion_file as module

DOCS = Path(__file__).parents[2] / "docs" / "motion.md"


@pytest.fixture(scope="module")
def path(motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("motion") / "motion.json"
    motion.save(path)
    return path


def test_a_motion_is_read_back_as_it_was(motion, path):
    again = MotionPlan.load(path)
    assert again.status is MotionStatus.SOLVED and again.reason == ""
    assert np.allclose(again.plan.poses, motion.plan.poses, rtol=0, atol=1e-12)
    assert np.array_equal(again.velocity_limits, motion.velocity_limits)
    assert again.squeeze == motion.squeeze and again.jaw_events == motion.jaw_events
    assert again.jerk_limits is None and motion.jerk_limits is None
    assert len(again.segments) == len(motion.segments)
    for a, b in zip(again.segments, motion.segments, strict=True):
        assert (a.phase, a.transition, a.grasp_id, a.jaw) == (b.phase, b.transition, b.grasp_id, b.jaw)
        for name in ("times", "positions", "velocities"):
            assert np.array_equal(getattr(a.trajectory, name), getattr(b.trajectory, name))


def broken(content, change):
    content = json.loads(json.dumps(content))
    change(content)
    return content


def shift(rows, by):
    for row in rows:
        row[0] += by


FAULTS = {
    "schema": lambda c: c.update(schema=3),
    "not a motion": lambda c: c.update(kind="plan"),
    "key 'status': should be one of solved": lambda c: c.update(status="done"),
    "key 'segments.0.phase': should be one of reach": lambda c: c["segments"][0].update(phase="dance"),
    "segments.0.jaw": lambda c: c["segments"][0].update(jaw=[0.1]),
    "do not fit its times": lambda c: c["segments"][1]["positions"].pop(),
    "do not ascend": lambda c: c["segments"][1]["times"].__setitem__(1, 0.0),
    "segments.1.times.1": lambda c: c["segments"][1]["times"].__setitem__(1, 1e300),
    "segments.1.positions.0.2": lambda c: c["segments"][1]["positions"][0].__setitem__(2, 1e308),
    "segments.2.jaw.0": lambda c: c["segments"][2].update(jaw=[-3.0, 0.1]),
    "velocity_limits.0": lambda c: c["velocity_limits"].__setitem__(0, 0.0),
    "if it is solved, and only then": lambda c: c.update(segments=[]),
    "unknown transition": lambda c: c["segments"][1].update(transition=9),
    "other joints": lambda c: c.update(joint_names=["a"] * 6),
    "jerk_limits.0": lambda c: c.update(jerk_limits=[0.0] * 6),
    "squeeze.below_contact": lambda c: c["squeeze"].update(below_contact=-0.01),
    "jaw events are not those of its segments": lambda c: c["jaw_events"][1].update(time=0.1),
    "there are no jaw events": lambda c: c.pop("jaw_events"),
    "in steps of 2 ns": lambda c: c["segments"][1]["times"].__setitem__(1, 1e-10),
    "segment 0 (reach) goes beyond the joint limits": lambda c: c["segments"][0]["positions"][9].__setitem__(0, 50.0),
    "segment 0 (reach) is faster than its limits": lambda c: c["segments"][0]["positions"][9].__setitem__(0, 0.3),
    "segment 3 (lift) does not begin where": lambda c: shift(c["segments"][3]["positions"], 1e-3),
    "segment 4 (transfer) does not begin where": lambda c: shift(c["segments"][4]["velocities"][:1], 0.01),
    "segment 2 (grasp) does not begin where": lambda c: c["segments"][2]["jaw"].__setitem__(0, 0.05),
    "plan schema": lambda c: c["plan"].update(schema=7),
}


@pytest.mark.parametrize("named", FAULTS)
def test_a_malformed_file_is_refused(path, tmp_path, named):
    content = broken(json.loads(path.read_text("utf-8")), FAULTS[named])
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(content), "utf-8")
    with pytest.raises(PlanFileError, match=re.escape(named)):
        MotionPlan.load(bad)


def test_a_file_of_schema_1_is_read(motion, path, tmp_path):
    content = json.loads(path.read_text("utf-8")) | {"schema": 1}
    for key in ("jerk_limits", "squeeze", "jaw_events"):
        del content[key]
    (tmp_path / "old.json").write_text(json.dumps(content), "utf-8")
    old = MotionPlan.load(tmp_path / "old.json")
    assert old.jerk_limits is None and old.squeeze == Squeeze()
    assert np.array_equal(old.segments[0].trajectory.positions, motion.segments[0].trajectory.positions)
    assert all(event.command == event.width_to and event.force is None for event in old.jaw_events)
    assert verify_motion(tmp_path / "old.json") == []
    content["segments"][3]["positions"][0][0] += 1e-3
    (tmp_path / "old.json").write_text(json.dumps(content), "utf-8")
    with pytest.raises(PlanFileError, match=r"segment 3 \(lift\)"):
        MotionPlan.load(tmp_path / "old.json")


def test_no_file_and_no_json_are_refused(tmp_path):
    with pytest.raises(PlanFileError, match="cannot read the motion"):
        MotionPlan.load(tmp_path / "none.json")
    (tmp_path / "cut.json").write_text("{", "utf-8")
    with pytest.raises(PlanFileError, match="not valid JSON"):
        MotionPlan.load(tmp_path / "cut.json")


def test_every_key_is_documented():
    text = DOCS.read_text("utf-8")
    for record in (module.MotionFile, module.SegmentSection, module.JawEventSection, module.SqueezeSection):
        for name, field in record.model_fields.items():
            assert f"`{field.alias or name}`" in text, name
    for kind in (Phase, MotionStatus):
        assert all(f"`{member.name.lower()}`" in text for member in kind)


def test_the_csv_holds_the_trajectories(motion, tmp_path):
    motion.save_csv(tmp_path / "motion.csv", 0.02)
    with (tmp_path / "motion.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = motion.plan.problem.workcell.robot.joint_names
    numbers = [f"{n}{what}" for what in ("", "_velocity", "_acceleration") for n in names]
    about = ["time", "phase", "arm", "gripper", "jaw"]
    assert list(rows[0]) == [*about, *numbers, "jaw_command", "jaw_force", "holds"]
    t = np.array([float(row["time"]) for row in rows])
    q = np.array([[float(row[n]) for n in names] for row in rows])
    v = np.array([[float(row[f"{n}_velocity"]) for n in names] for row in rows])
    assert t[0] == 0 and t[-1] == pytest.approx(motion.duration, abs=1e-6)
    assert np.allclose(np.diff(t)[:-1], 0.02, atol=1e-6) and 0 < np.diff(t)[-1] < 0.0301
    for row, start, segment in zip(rows, t, q, strict=True):
        assert Phase[row["phase"].upper()] and np.isfinite(start) and segment.shape == (6,)
    # integrating the velocities gives the positions
    assert np.allclose(q[0] + np.cumsum((v[1:] + v[:-1]) / 2 * np.diff(t)[:, None], axis=0), q[1:], atol=2e-3)
    assert {(row["arm"], row["gripper"]) for row in rows} == {("nova2", "w")}
    a = np.array([[float(row[f"{n}_acceleration"]) for n in names] for row in rows])
    assert np.allclose(np.cumsum((a[1:] + a[:-1]) / 2 * np.diff(t)[:, None], axis=0), v[1:], atol=0.1)
    for row in rows:
        held = row["phase"] in ("grasp", "lift", "transfer", "lower")
        assert row["holds"] == str(int(held)) and row["jaw_force"] == ""
        if row["phase"] == "lift":
            assert float(row["jaw_command"]) == pytest.approx(float(row["jaw"]) - motion.squeeze.below_contact)
    assert {row["phase"] for row in rows} == {s.phase.name.lower() for s in motion.segments}


def test_csv_of_a_bad_step_or_no_motion_is_refused(motion, tmp_path):
    for step in (0.0, 1e-320, motion.duration / 1.1e6, np.nan, np.inf):
        with pytest.raises(OptionError, match="step is"):
            motion.save_csv(tmp_path / "x.csv", step)
    unsolved = MotionPlan(MotionStatus.NO_MOTION, "blocked", motion.plan, (), *[np.ones(6)] * 2, 0.0)
    with pytest.raises(PlanFileError, match="blocked"):
        unsolved.save_csv(tmp_path / "x.csv")
    assert not list(tmp_path.iterdir())


def test_the_scene_is_read_by_another_urdf_reader(motion, tmp_path):
    motion.save_scene(tmp_path)
    problem = motion.plan.problem
    robot, effector = problem.workcell.robot, problem.workcell.end_effector
    scene = json.loads((tmp_path / "scene.json").read_text("utf-8"))
    model = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf"))
    assert list(model.names)[1:] == scene["joint_names"] and model.existFrame(scene["flange_link"])
    data = model.createData()
    pin.framesForwardKinematics(model, data, robot.home)
    flange = data.oMf[model.getFrameId(scene["flange_link"])].homogeneous
    assert np.allclose(flange, robot.forward(robot.home), atol=1e-9)
    assert np.allclose(np.array(scene["object_poses"]), motion.plan.poses)

    gripper = pin.buildModelFromUrdf(str(tmp_path / "gripper.urdf"))
    assert list(gripper.names)[1:] == ["left_finger_joint", "right_finger_joint"]
    assert np.allclose(gripper.upperPositionLimit, effector.max_opening / 2)
    bodies = pin.buildGeomFromUrdf(gripper, str(tmp_path / "gripper.urdf"), pin.GeometryType.COLLISION)
    at, placed = gripper.createData(), bodies.createData()
    pin.updateGeometryPlacements(gripper, at, bodies, placed, np.full(2, 0.03))
    wanted = effector.finger_boxes(0.06)
    fingers = [placed.oMg[n].homogeneous for n, item in enumerate(bodies.geometryObjects) if item.parentJoint > 0]
    assert np.allclose(sorted(T[1, 3] for T in fingers), sorted(box.pose[1, 3] for box in wanted))

    surroundings = pin.buildModelFromUrdf(str(tmp_path / "surroundings.urdf"))
    fixed = pin.buildGeomFromUrdf(
        surroundings, str(tmp_path / "surroundings.urdf"), pin.GeometryType.COLLISION
    ).geometryObjects
    table = problem.workcell.table.shape
    assert np.allclose(fixed[0].placement.homogeneous, table.pose) and np.allclose(
        2 * np.array(fixed[0].geometry.halfSide), table.size
    )
    mesh = trimesh.load(tmp_path / "object.stl")
    assert mesh.is_watertight and mesh.volume == pytest.approx(problem.object.mesh.volume, rel=1e-4)
    held = {entry["grasp_id"]: np.array(entry["T_tcp_object"]) for entry in scene["object_in_hand"]}
    for g, T in held.items():
        assert np.allclose(T @ problem.grasps.T_object_tcp[g], np.eye(4), atol=1e-12)


def test_a_motion_of_a_plan_of_schema_1_is_read(motion, path, tmp_path):
    content = json.loads(path.read_text("utf-8"))
    cell = motion.plan.problem.workcell
    reference = {key: content["plan"]["workcell"][key] for key in ("source", "name", "end_effector")}
    content["plan"] |= {"schema": 1, "workcell": reference | {"fingerprint": cell.fingerprint()}}
    (tmp_path / "old.json").write_text(json.dumps(content), "utf-8")
    old = MotionPlan.load(tmp_path / "old.json")
    assert old.duration == motion.duration and old.plan.problem.workcell.fingerprint() == cell.fingerprint()
