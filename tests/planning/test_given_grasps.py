"""Grasps from other tools: put on the object, counted where they cannot be used, and kept by plans."""

from __future__ import annotations

import json
import os

import grasp_files
import numpy as np
import pytest
from grasp_files import Z_APPROACH_X_CLOSING, hand_poses, write
from scipy.spatial.transform import Rotation

from regrasp_opt import GraspSet, RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.conventions import pose_distance
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.motion import plan_motion
from regrasp_opt.planning.given_grasps import Near
from regrasp_opt.planning.prepare import prepare
from regrasp_opt.planning.tasks import random_task

PANDA = 0.1034


@pytest.fixture(scope="module")
def given(bottle_problem):
    """Return tool poses on the bottle, spread over the built-in set, and how far the jaw is open there."""
    return bottle_problem.grasps.T_object_tcp[::2], bottle_problem.grasps.width[::2]


@pytest.fixture(scope="module")
def acronym(given, tmp_path_factory):
    """Return an ACRONYM file (in JSON, which needs no package) of these grasps; every tenth of them failed there."""
    T, success = hand_poses(given[0], PANDA, Z_APPROACH_X_CLOSING), np.arange(len(given[0])) % 10 > 0
    return write(tmp_path_factory.mktemp("files") / "bottle.json", grasp_files.acronym_json(T, success))


def moved(T, shift=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0)):
    """Return poses moved [m] and turned (a rotation vector, [rad]) in their own frames."""
    step = np.eye(4)
    step[:3, 3], step[:3, :3] = shift, Rotation.from_rotvec(rotation).as_matrix()
    return T @ step


def load(grasps, **options):
    return RegraspProblem.load("bottle", "nova2-w", grasps=grasps, **options)


def test_widths_are_found_on_the_object(given, acronym):
    problem = load(acronym)
    kept = np.flatnonzero(np.arange(len(given[0])) % 10 > 0)
    assert problem.left_out == {} and problem.grasps.settled
    assert problem.grasps.names == tuple(map(str, kept))
    distance, angle = pose_distance(problem.grasps.T_object_tcp, given[0][kept])
    assert distance.max() < 1e-3 and angle.max() < np.deg2rad(5)
    np.testing.assert_allclose(problem.grasps.width, given[1][kept], atol=4e-3)  # as much as a pad may close wider
    assert (np.abs(problem.grasps.width - given[1][kept]) < 1e-9).mean() > 0.9


def test_a_grasp_is_moved_to_its_contacts_if_they_are_near(given):
    T = given[0]
    beside = GraspSet(moved(T, (0.0, 0.004, 0.0)), None, "parallel")
    problem = load(beside)
    near = pose_distance(problem.grasps.T_object_tcp, T[[k for k in range(len(T)) if k not in problem.left_out]])[0]
    assert len(problem.grasps) > 0.9 * len(T) and near.max() < 2e-3
    strict = load(beside, near=Near(0.005, 0.0))
    assert set(strict.left_out) >= set(problem.left_out)
    with pytest.raises(
        GraspError, match="because it would have to be moved more than 1 mm or turned more than 5 degrees"
    ):
        load(beside, near=Near(0.001))
    for near_wrong in (Near(-0.001), Near(np.nan), Near(0.001, np.inf)):
        with pytest.raises(OptionError, match="give a distance in metres and an angle in radians"):
            load(beside, near=near_wrong)


def test_what_is_left_out_is_counted_and_named(given, caplog):
    T = given[0].copy()
    T[[2, 9]] = moved(T[[2, 9]], (0.0, 0.0, -0.2))
    T[5] = moved(T[5], (0.0, 0.0, 0.0), (0.0, 0.0, 0.7))
    names = tuple(f"grasp_{k}" for k in range(len(T)))
    with caplog.at_level("WARNING"):
        problem = load(GraspSet(T, None, "parallel", names))
    far = "it would have to be moved more than 5 mm or turned more than 5 degrees to hold the object"
    reasons = {k: why.split(" between")[0] for k, why in problem.left_out.items()}
    assert reasons[2] == reasons[9] == "no part of the object is" and reasons[5] == far
    assert problem.grasps.names == tuple(name for k, name in enumerate(names) if k not in problem.left_out)
    (text,) = [record.getMessage() for record in caplog.records]
    assert (
        text.startswith(f"{len(reasons)} of {len(T)} grasps are left out")
        and "2 because no part" in text
        and "(grasp_2, grasp_9); 1 because it would" in text
    )


def test_wrong_frames_are_named_with_the_frame_that_fits(acronym, given, tmp_path, caplog):
    for frame in ("tcp", "-z,x,0.1034"):
        with pytest.raises(
            GraspError, match=r"hand frame '.*'; \d+ of \d+ that were tried hold with the frame 'acronym'"
        ):
            load(GraspSet.load(acronym, frame=frame))
    sideways = hand_poses(given[0], 0.12, np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    sideways[:, :3, 3] = given[0][:, :3, 3] - 0.12 * given[0][:, :3, 2]  # approaches along its x, closes along its z
    path = write(tmp_path / "other.json", grasp_files.acronym_json(sideways, np.ones(len(sideways))))
    with pytest.raises(GraspError, match=r"tried hold with the frame '-?x,[yz],0\.12' \(--grasp-frame\)"):
        load(GraspSet.load(path, frame="y,x,0.12"))
    caplog.clear()
    few = load(GraspSet.load(acronym, frame="panda_hand"))  # turned by a right angle: what still fits is sound
    assert len(few.grasps) < len(few.left_out) and "hold with the frame 'acronym'" in caplog.text


def test_a_scale_that_the_mesh_has_not_is_said(given, tmp_path):
    T = hand_poses(given[0], PANDA, Z_APPROACH_X_CLOSING)
    T[:, :3, 3] += 0.1 * given[0][:, :3, 2]  # the palm in the bottle
    path = write(tmp_path / "bottle.json", grasp_files.acronym_json(T, np.ones(len(T)), scale=0.25))
    with pytest.raises(
        GraspError, match=r"is for the mesh 'meshes/Mug/1a\.obj' at scale 0\.25, and 'bottle' is loaded at"
    ):
        load(path)


def test_millimetres_that_are_small_are_found_on_the_object(given, tmp_path):
    T = given[0].copy()
    T[:, :3, 3] *= 60.0
    path = write(tmp_path / "bottle.json", grasp_files.acronym_json(T, np.ones(len(T))))
    with pytest.raises(
        GraspError, match=r"from the object; give scale \(--grasp-scale\) 0\.001 if it is in millimetres"
    ):
        load(GraspSet.load(path, frame="tcp"))


def test_another_kind_of_gripper_is_refused(given, tmp_path):
    path = write(tmp_path / "cup.json", grasp_files.graspgen(given[0], np.ones(len(given[0]))))
    with pytest.raises(GraspError, match="for a suction end-effector, which 'w' is not"):
        load(GraspSet.load(path, frame="single_suction_cup_30mm"))
    with pytest.raises(GraspError, match="for a parallel end-effector, which 's1' is not"):
        RegraspProblem.load("bottle", "nova2-s1", grasps=GraspSet.load(path, frame="franka_panda"))


def test_cups_are_put_on_the_surface(tmp_path):
    clean = RegraspProblem.load("bottle", "nova2-s1")
    T = moved(sample_grasps(clean.object, clean.workcell.end_effector, 60, seed=3).T_object_tcp, (0.0, 0.0, -0.003))
    T[7] = moved(T[7], (0.0, 0.0, -0.1))
    path = write(tmp_path / "cup.json", grasp_files.graspgen(T, np.ones(len(T))))
    problem = RegraspProblem.load("bottle", "nova2-s1", grasps=GraspSet.load(path, frame="single_suction_cup_30mm"))
    assert problem.left_out[7] == "the cup does not touch the object" and len(problem.left_out) < 10
    assert (problem.grasps.width == 0).all() and problem.grasps.kind == "suction"
    kept = [k for k in range(len(T)) if k not in problem.left_out]
    lifted = np.einsum("gi,gi->g", problem.grasps.T_object_tcp[:, :3, 3] - T[kept, :3, 3], T[kept, :3, 2])
    np.testing.assert_allclose(lifted, 0.003, atol=1e-4)


@pytest.fixture(scope="module")
def plan(acronym, tmp_path_factory):
    """Return a plan with grasps of a file that is gone by now, read back from its own file."""
    folder = tmp_path_factory.mktemp("plans")
    copy = folder / "gone.json"
    copy.write_bytes(acronym.read_bytes())
    problem = load(copy)
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    made = solve_sequence(problem, task.start, task.goal)
    assert made.solved
    made.save(folder / "plan.json")
    os.remove(copy)
    return made, RegraspPlan.load(folder / "plan.json")


def test_a_plan_keeps_the_grasps_and_their_names_when_the_file_is_gone(plan):
    made, loaded = plan
    assert loaded.problem.grasps.fingerprint() == made.problem.grasps.fingerprint()
    assert loaded.problem.grasps.names == made.problem.grasps.names != ()
    assert loaded.residuals().hold
    assert plan_motion(loaded).solved


def test_the_same_file_gives_the_same_plan(plan, acronym):
    made = plan[0]
    again = solve_sequence(load(acronym), made.poses[0], made.poses[-1])
    np.testing.assert_allclose(again.poses, made.poses, atol=1e-9)
    for a, b in zip(again.transitions, made.transitions, strict=True):
        np.testing.assert_array_equal(a.grasp_ids, b.grasp_ids)


def test_names_of_some_grasps_alone_are_refused(plan, tmp_path):
    plan[0].save(tmp_path / "plan.json")
    content = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    del content["grasps"][3]["name"]
    (tmp_path / "plan.json").write_text(json.dumps(content), "utf-8")
    with pytest.raises(Exception, match="some grasps have names and others have none; save the plan again"):
        RegraspPlan.load(tmp_path / "plan.json")


def test_a_model_is_prepared_with_given_grasps(acronym, tmp_path, bottle_problem):
    grasps = GraspSet.load(acronym).subset(range(0, 90, 3))
    folder, report = prepare(
        bottle_problem.object, bottle_problem.workcell, samples=300, grasps=grasps, out=tmp_path / "model", jobs=1
    )
    assert report["grasps"] == len(grasps)
    assert f"--grasps {acronym} --grasp-frame=acronym --grasp-near 0.005,5" in report["command"]
    problem = RegraspProblem.load("bottle", "nova2-w", model=folder)
    assert problem.grasps.names == grasps.names and problem.left_out == {}
    assert len(problem.energy.grasps) == len(grasps)
