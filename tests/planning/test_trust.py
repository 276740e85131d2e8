"""What must not slip through: objects that cannot stay where they are put, grasps of unknown origin, threads."""

import dataclasses
import json
import shlex
import shutil
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt import GraspSet, RegraspPlan, RegraspProblem, load_workcell, solve_sequence
from regrasp_opt.cli.app import run
from regrasp_opt.errors import GraspError, ModelError, PoseError, UnknownNameError
from regrasp_opt.feasibility.standing import resting_problem, standing_problem
from regrasp_opt.motion import plan_motion
from regrasp_opt.objects import ObjectModel, stable_placements
from regrasp_opt.planning.residuals import _rest_violations
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.scene import Support


def _on_table(problem, rotation):
    """Return the pose with `rotation` whose lowest vertex touches the table, over the middle of the workspace."""
    T = np.eye(4)
    T[:3, :3] = rotation
    lowest = (problem.object.vertices @ rotation[2]).min()
    T[:3, 3] = [0.0, 0.35, problem.workcell.table.height - lowest]
    T[:2, 3] -= (rotation @ problem.object.center_of_mass)[:2]
    return T


@pytest.mark.parametrize("degrees", [10, 30, 45])
def test_a_start_that_would_tip_over_is_refused(bottle_problem, degrees):
    upright = bottle_problem.pose(4, 0.0, 0.35)[:3, :3]
    tilted = _on_table(bottle_problem, Rotation.from_euler("x", degrees, degrees=True).as_matrix() @ upright)
    with pytest.raises(PoseError, match="would tip over at the start pose"):
        solve_sequence(bottle_problem, tilted, bottle_problem.pose(0, 0.2, 0.35))


def test_a_start_on_a_side_that_rolls_is_refused():
    can = trimesh.creation.cylinder(0.03, 0.10, sections=24)
    problem = RegraspProblem.load(ObjectModel("can", can, stable_placements(can)), "nova2-w")
    upright = problem.pose(0, 0.0, 0.35)
    assert not _rest_violations(SimpleNamespace(problem=problem, poses=[upright, upright]))
    lying = _on_table(problem, Rotation.from_euler("yx", [90, 7.5], degrees=True).as_matrix())
    with pytest.raises(PoseError, match="would roll at the start pose"):
        solve_sequence(problem, lying, upright)
    rolled = _rest_violations(SimpleNamespace(problem=problem, poses=[upright, lying]))
    assert rolled == ["the object would roll at the goal"]


def test_every_stable_placement_can_be_a_start(bottle_problem):
    for number in range(len(bottle_problem.placements)):
        T = bottle_problem.pose(number, 0.1, 0.3, 1.0)
        body = bottle_problem.object
        vertices = body.vertices @ T[:3, :3].T + T[:3, 3]
        center = T[:3, :3] @ body.center_of_mass + T[:3, 3]
        assert resting_problem(vertices, center, bottle_problem.workcell.table) is None


def test_an_object_over_the_table_edge_does_not_stand(bottle_problem):
    small = Support.table(0.0, np.array([0.0, 0.35]), np.array([0.6, 0.6]), 0.05)
    vertices = bottle_problem.object.vertices
    for x, problem in ((0.0, None), (0.29, "stands over the edge of the table")):
        T = bottle_problem.pose(0, x, 0.35)
        assert standing_problem(vertices @ T[:3, :3].T + T[:3, 3], small) == problem


def test_no_grasp_is_feasible_for_an_object_in_the_table(bottle_problem):
    T = bottle_problem.pose(0, 0.2, 0.35)
    assert bottle_problem.feasible_grasps(T).any()
    T[2, 3] -= 0.01
    assert not bottle_problem.feasible_grasps(T).any()


@pytest.mark.parametrize("end", [0, -1])
@pytest.mark.parametrize(("gap", "refused"), [(0.1, True), (0.0011, True), (0.0009, False), (-0.0011, True)])
def test_residuals_see_that_an_end_hovers_or_sinks(plan, end, gap, refused):
    poses = plan.poses.copy()
    poses[end, 2, 3] += gap
    texts = dataclasses.replace(plan, poses=poses, transitions=()).residuals().problems
    assert any(f"does not touch the table at the {('start', 'goal')[end]}" in text for text in texts) == refused


@pytest.mark.parametrize("end", [0, -1])
@pytest.mark.parametrize(("share", "refused"), [(0.99, False), (1.01, True)])
def test_residuals_see_that_an_end_tips_over(plan, monkeypatch, end, share, refused):
    body, T = plan.problem.object, plan.poses[end]
    points = body.vertices @ T[:3, :3].T + T[:3, 3]
    center = T[:3, :3] @ body.center_of_mass + T[:3, 3]
    corner = points[points[:, 2].argmin()]  # of what it stands on
    center[:2] += share * (corner - center)[:2]
    monkeypatch.setitem(vars(body), "center_of_mass", T[:3, :3].T @ (center - T[:3, 3]))
    texts = dataclasses.replace(plan, transitions=()).residuals().problems
    assert (f"the object would tip over at the {('start', 'goal')[end]}" in texts) == refused


@pytest.mark.parametrize("end", [0, -1])
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("side", [0, 1])
def test_residuals_see_that_an_end_lies_outside_the_workspace(plan, end, axis, side):
    T, cell = plan.poses[end], plan.problem.workcell
    center = (T[:3, :3] @ plan.problem.object.center_of_mass + T[:3, 3])["xy".index(axis)]

    def refused(beyond):
        limits = [-1.0, 1.0]
        limits[side] = center + beyond * (1, -1)[side]
        bounds = dataclasses.replace(cell.bounds, **{axis: tuple(limits)})
        problem = dataclasses.replace(plan.problem, workcell=cell.within(bounds))
        texts = dataclasses.replace(plan, problem=problem, transitions=()).residuals().problems
        return f"the {('start', 'goal')[end]} lies outside the workspace" in texts

    assert refused(1e-5) and not refused(-1e-5)


def test_grasps_of_unknown_origin_are_checked(bottle_problem):
    grasps = bottle_problem.grasps
    ahead, behind = grasps.T_object_tcp.copy(), grasps.T_object_tcp.copy()
    ahead[:, :3, 3] += 0.1 * ahead[:, :3, 2]  # the palm in the bottle
    behind[:, :3, 3] -= 0.103 * behind[:, :3, 2]
    count = len(grasps)
    cases = [
        (GraspSet(grasps.T_object_tcp, np.zeros(count), "suction"), "for a suction end-effector, which 'w' is not"),
        (GraspSet(grasps.T_object_tcp, grasps.width + 0.2, "parallel"), f"{count} because it needs a wider opening"),
        (GraspSet(ahead, grasps.width, "parallel"), "because the gripper overlaps the object"),
        (GraspSet(behind, grasps.width, "parallel"), f"{count} because no part of the object is between the pads"),
    ]
    cases.append((grasps.T_object_tcp, "grasps is a ndarray; give a GraspSet"))
    for wrong, text in cases:
        with pytest.raises(GraspError, match=text):
            RegraspProblem.load("bottle", "nova2-w", grasps=wrong)


def test_grasps_that_fail_are_left_out_by_number_and_reason(bottle_problem, caplog):
    grasps = bottle_problem.grasps
    T, width = grasps.T_object_tcp.copy(), grasps.width.copy()
    T[[2, 9, 11], :3, 3] -= 0.103 * T[[2, 9, 11], :3, 2]
    T[5, :3, 3] += 0.1 * T[5, :3, 2]
    width[7] = 0.103
    with caplog.at_level("WARNING"):
        problem = RegraspProblem.load("bottle", "nova2-w", grasps=GraspSet(T, width, "parallel"))
    assert {number: text.split()[0] for number, text in problem.left_out.items()} == {
        2: "no", 5: "the", 7: "it", 9: "no", 11: "no"
    }  # fmt: skip
    kept = [number for number in range(len(grasps)) if number not in problem.left_out]
    assert problem.grasps.fingerprint() == grasps.subset(kept).fingerprint()
    (text,) = [record.getMessage() for record in caplog.records]
    assert text.startswith(
        f"5 of {len(grasps)} grasps are left out, and the others renumbered from 0: 3 because no part"
    )
    assert "pads (2, 9, 11); 1 because the gripper overlaps the object (5); 1 because" in text


def test_a_sound_set_is_taken_as_it_is_without_a_word(bottle_problem, caplog):
    single = GraspSet(
        bottle_problem.grasps.T_object_tcp.astype(np.float32).tolist(), bottle_problem.grasps.width, "parallel"
    )
    problem = RegraspProblem.load("bottle", "nova2-w", grasps=single)
    assert problem.left_out == {} and problem.grasps is single and not caplog.records


def test_grasps_of_a_model_that_is_named_are_checked(bottle_problem, tmp_path):
    folder = shutil.copytree(bottle_problem.model_folder, tmp_path / "model")
    grasps = bottle_problem.grasps
    T = grasps.T_object_tcp.copy()
    T[1, :3, 3] -= 0.103 * T[1, :3, 2]
    edited = GraspSet(T, grasps.width, "parallel")
    edited.save(folder / "grasps.npz")
    report = json.loads((folder / "report.json").read_text("utf-8"))
    (folder / "report.json").write_text(json.dumps({**report, "grasps_fingerprint": edited.fingerprint()}), "utf-8")
    assert list(RegraspProblem.load("bottle", "nova2-w", model=folder).left_out) == [1]


@pytest.mark.parametrize("change", ["back", "sideways", "wide", "turned"])
def test_a_plan_file_whose_grasp_was_edited_does_not_hold(plan, tmp_path, change):
    plan.save(tmp_path / "plan.json")
    content = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    number = content["transitions"][0]["grasp_ids"][0]
    grasp = content["grasps"][number]
    T = np.array(grasp["T_object_tcp"])
    if change == "wide":
        grasp["width"] += 0.005
    else:
        move = np.eye(4)
        move[:3, 3] = {"back": [0, 0, -0.103], "sideways": [0.2, 0, 0], "turned": [0, 0, 0]}[change]
        move[:3, :3] = Rotation.from_euler("z", 40 * (change == "turned"), degrees=True).as_matrix()
        grasp["T_object_tcp"] = (T @ move).tolist()
    (tmp_path / "plan.json").write_text(json.dumps(content), "utf-8")
    loaded = RegraspPlan.load(tmp_path / "plan.json")
    assert len(loaded.problem.grasps) == len(plan.problem.grasps)
    texts = loaded.residuals().problems
    assert any(text.startswith(f"transition 0: grasp {number} does not hold the object: ") for text in texts)
    assert run(["check", str(tmp_path / "plan.json")]) == 1
    motion = plan_motion(dataclasses.replace(loaded, transitions=tuple(_only(t, number) for t in loaded.transitions)))
    assert not motion.solved and "holds the object" in motion.reason


def _only(transition, grasp_id):
    keep = transition.grasp_ids == grasp_id
    parts = (transition.grasp_ids, transition.q_pick, transition.q_place, transition.clearance)
    return type(transition)(*(part[keep] for part in parts))


def test_a_plan_with_renumbered_grasps_is_the_same_when_loaded_again(bottle_problem, task, tmp_path):
    T = bottle_problem.grasps.T_object_tcp.copy()
    T[::7, :3, 3] -= 0.103 * T[::7, :3, 2]
    problem = RegraspProblem.load("bottle", "nova2-w", grasps=GraspSet(T, bottle_problem.grasps.width, "parallel"))
    assert len(problem.left_out) == len(T[::7])
    made = solve_sequence(problem, task.start, task.goal)
    made.save(tmp_path / "plan.json")
    loaded = RegraspPlan.load(tmp_path / "plan.json")
    assert made.solved and loaded.residuals().hold
    assert loaded.problem.grasps.fingerprint() == problem.grasps.fingerprint()
    for a, b in zip(made.transitions, loaded.transitions, strict=True):
        np.testing.assert_array_equal(a.grasp_ids, b.grasp_ids)


def test_a_plan_with_another_end_effector_can_be_loaded_again(tmp_path, bottle_problem):
    problem = RegraspProblem.load("bottle", "nova2-w", end_effector="r140")
    object.__setattr__(problem, "energy", bottle_problem.energy)
    assert not RegraspProblem.load("bottle", "nova2-w", end_effector="r140").model_folder
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=False)
    plan = solve_sequence(problem, task.start, task.goal)
    plan.save(tmp_path / "plan.json")
    loaded = RegraspPlan.load(tmp_path / "plan.json")
    assert loaded.residuals().hold
    assert loaded.problem.workcell.end_effector.name == "r140"
    assert load_workcell("nova2-w", end_effector="r140").name == "nova2-w"


def test_the_command_that_prepares_a_missing_model_says_all_that_differs(bottle_problem, tmp_path):
    path = tmp_path / "my bottle.stl"
    bottle_problem.object.mesh.export(path)
    cell = {"end_effector": "r140", "preset": "paper"}
    problem = RegraspProblem.load(path, "nova2-w", scale=0.9, repair=True, **cell)
    with pytest.raises(ModelError) as info:
        _ = problem.energy
    command = str(info.value).split("run '", 1)[1].removesuffix("'")
    words = ["nova2-w", "--end-effector", "r140", "--object", str(path), "--scale", "0.9", "--repair"]
    assert shlex.split(command) == ["regrasp-opt", "prepare", *words]


def test_an_unknown_preset_is_named():
    with pytest.raises(UnknownNameError, match="unknown preset 'papr'; known: paper, default"):
        RegraspProblem.load("bottle", "nova2-w", preset="papr")


def test_one_problem_serves_several_threads(bottle_problem):
    checker, T = bottle_problem.checker, bottle_problem.pose(0, 0.2, 0.35, 0.4)
    ids = np.flatnonzero(bottle_problem.feasible_grasps(T))
    cases = [(g, q) for g, found in zip(ids, checker.configurations(T, ids), strict=True) for q in found[:2]]
    expected = [checker.clearance(T, g, q) for g, q in cases]
    wrong: list[int] = []

    def work():
        answers = [checker.clearance(T, g, q) for g, q in cases]
        wrong.append(sum(a != b for a, b in zip(answers, expected, strict=True)))

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    sys.setswitchinterval(interval)
    assert wrong == [0, 0, 0, 0]
