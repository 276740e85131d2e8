"""The energy of an arm: trained without an object, found by its arm, refused for another, used in every scene."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, load_workcell, solve_sequence
from regrasp_opt.connectivity import block
from regrasp_opt.conventions import planar_transform
from regrasp_opt.energy.calibration import average_precision
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.energy.storage import load_energy, save_energy
from regrasp_opt.errors import ModelError, OptionError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.dataset import random_poses
from regrasp_opt.feasibility.tool_poses import label_tool_poses
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.grasps import GraspSet
from regrasp_opt.planning.arm_energy import find_arm_energy, load_arm_energy, train_arm_energy
from regrasp_opt.planning.model_key import ArmKey
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.scene.loading import WORKCELL_NAMES

BUILT_IN = """schema = 1
[robot]
model = "nova2"
position = [0.0, 0.0, {height}]
[end_effector]
model = "{effector}"
[table]
height = {height}
center = [0.0, 0.35]
size = [1.4, 1.2]
[workspace]
x = [-0.45, 0.45]
y = [0.1, 0.6]
"""


@pytest.fixture
def nova2_w():
    return load_workcell("nova2-w")


def cell(tmp_path, height=0.0, effector="w", more=""):
    path = tmp_path / "cell.toml"
    path.write_text(BUILT_IN.format(height=height, effector=effector) + more)
    return load_workcell(path)


@pytest.mark.parametrize("name", WORKCELL_NAMES)
def test_every_built_in_cell_has_a_bundled_energy_that_ranks_unseen_objects(name):
    path = find_arm_energy(load_workcell(name))
    assert path is not None and path.stem == name and path.stat().st_size < 1_000_000
    card = load_energy(path).metadata
    assert set(card["unseen"]) == {"bottle", "mug", "pentagon", "figurine"} and min(card["unseen"].values()) > 0.97
    assert card["command"] == f"regrasp-opt prepare {name} --poses 300000 --seed 0"


def test_the_bundled_energy_ranks_a_mesh_it_never_saw_as_the_card_claims(nova2_w, tmp_path, bottle_problem):
    """Against the exact check, by hand, on a scaled bottle."""
    path = tmp_path / "part.stl"
    bottle_problem.object.mesh.export(path)
    problem = RegraspProblem.load(path, nova2_w, scale=0.85)
    assert problem.model_folder is None and problem.energy.model.features == "arm"
    numbers, xi = random_poses(problem.placement_poses, nova2_w.bounds.array, 40, np.random.default_rng(5))
    T = planar_transform(xi) @ problem.placement_poses[numbers]
    feasible = np.array([problem.feasible_grasps(pose) for pose in T])
    ruled_out = problem.ruled_out(numbers, xi)
    assert not (ruled_out & feasible).any()
    energies = block(problem.energy(T), ruled_out)
    assert average_precision(energies.ravel(), feasible.ravel()) > 0.95
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(problem, task.start, task.goal)
    assert plan.solved and plan.num_regrasps >= 1 and plan.residuals().hold


def test_labels_are_the_exact_check_and_do_not_depend_on_the_workers(nova2_w):
    labels = label_tool_poses(nova2_w, 12_000, seed=3, jobs=1)
    again = label_tool_poses(nova2_w, 12_000, seed=3, jobs=2)
    np.testing.assert_array_equal(labels.T, again.T)
    np.testing.assert_array_equal(labels.feasible, again.feasible)
    assert 0.3 < labels.feasible.mean() < 0.7 and len(np.unique(labels.width)) > 10
    sample = np.random.default_rng(0).choice(len(labels), 200, replace=False)
    width = labels.width[sample]
    checker = FeasibilityChecker(None, nova2_w, GraspSet(np.tile(np.eye(4), (200, 1, 1)), width, "parallel"))
    np.testing.assert_array_equal(checker.feasible_pairs(labels.T[sample], np.arange(200)), labels.feasible[sample])


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return the workcell of a raised arm, and the energy that was trained for it."""
    folder = tmp_path_factory.mktemp("arm")
    raised = cell(folder, height=0.2)
    said = []
    options = {"out": folder / "arm.safetensors", "jobs": 1, "progress": lambda *step: said.append(step)}
    path, card = train_arm_energy(raised, poses=24_000, **options)
    return raised, path, card, said


def test_training_keeps_a_card_and_says_how_far_it_is(small):
    _, path, card, said = small
    assert {what for what, _, _ in said} == {"labelling", "training"}
    assert card["poses"] == 24_000 and 0 < card["feasible_poses"] < 24_000
    assert set(card["times"]) == {"labelling", "training", "evaluation"}
    assert min(card["unseen"].values()) > 3 * card["held_out"]["feasible_share"]
    assert load_energy(path).metadata == card


def test_an_energy_in_the_frame_of_the_base_serves_a_raised_arm(small, nova2_w):
    """The same tool pose relative to the base has the same energy, whatever the base stands on."""
    raised, path, _, _ = small
    stored, model = load_energy(path), load_arm_energy(path, raised)
    T = label_tool_poses(nova2_w, 1, seed=1, jobs=1).T[:50]
    grasp = GraspSet(np.eye(4)[None], np.array([0.03]), "parallel")
    lifted = raised.arm.T_world_base @ T
    np.testing.assert_allclose(GraspEnergy(model, grasp)(lifted), GraspEnergy(stored, grasp)(T), atol=1e-4)


@pytest.mark.parametrize(("change", "said"), [({"height": 0.0}, "mounting"), ({"effector": "r85"}, "end-effector")])
def test_the_energy_of_another_arm_is_refused_and_named(small, tmp_path, change, said):
    other = cell(tmp_path, **{"height": 0.2, **change})
    with pytest.raises(ModelError, match=f"is the energy of another {said} than 'nova2' with"):
        load_arm_energy(small[1], other)
    with pytest.raises(ModelError, match=f"another {said}"):
        RegraspProblem.load("mug", other, model=small[1])


def test_a_named_energy_is_used_and_other_surroundings_are_said(small, tmp_path, caplog):
    wall = '[[obstacles]]\nname = "wall"\ntype = "box"\nsize = [0.1, 0.1, 0.3]\nposition = [0.4, 0.5, 0.35]\n'
    other = cell(tmp_path, height=0.2, more=wall)
    problem = RegraspProblem.load("mug", other, model=small[1])
    with caplog.at_level(logging.INFO, logger="regrasp_opt"):
        energy = problem.energy
    assert problem.energy_file == small[1] and energy.model.features == "arm"
    assert "other supports or obstacles" in caplog.text


def test_where_no_energy_is_there_it_is_trained_once_and_kept(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("regrasp_opt.planning.arm_energy.POSES", 12_000)
    problem = RegraspProblem.load("pentagon", cell(tmp_path, height=0.1))
    assert problem.energy_file is None
    first = problem.energy
    assert "training an energy for 'nova2' with 'w', once" in caplog.text
    caplog.clear()
    again = RegraspProblem.load("mug", cell(tmp_path, height=0.1))
    assert again.energy_file is not None and (tmp_path / "home") in again.energy_file.parents
    assert again.energy.model.fingerprint() == first.model.fingerprint() and not caplog.text


def test_an_arm_that_can_be_nowhere_says_why(nova2_w, tmp_path):
    walled_in = replace(nova2_w, obstacles=(Box("concrete", np.array([3.0, 3.0, 3.0]), np.eye(4)),))
    with pytest.raises(ModelError, match=r"of 200 tool poses \d+ .*\d+ (gripper|arm) in obstacle 'concrete'"):
        train_arm_energy(walled_in, poses=12_000, out=tmp_path / "arm.safetensors", jobs=1)
    assert not (tmp_path / "arm.safetensors").exists()


@pytest.mark.parametrize(("options", "said"), [({"poses": 10}, "poses is 10"), ({"jobs": 0}, "jobs is 0")])
def test_bad_options_are_refused(nova2_w, options, said):
    with pytest.raises(OptionError, match=said):
        train_arm_energy(nova2_w, **options)


def test_a_folder_or_a_place_that_cannot_be_written_is_refused_before_work_is_spent(nova2_w, tmp_path):
    with pytest.raises(OptionError, match="is a folder; give the name of a file"):
        train_arm_energy(nova2_w, out=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match="cannot be written to"):
        train_arm_energy(nova2_w, out=tmp_path / "file" / "arm.safetensors")


def test_a_broken_energy_in_the_data_folder_is_left_out(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path / "home"))
    own = cell(tmp_path, height=0.1)
    path = tmp_path / "home" / "arms" / f"{ArmKey.of(own).id}.safetensors"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"garbage")
    assert find_arm_energy(own) is None and "corrupt" in caplog.text


@pytest.mark.parametrize("missing", ["robot", "mounting", "end_effector"])
def test_a_card_that_does_not_say_for_which_arm_is_refused(nova2_w, tmp_path, missing):
    model = load_energy(find_arm_energy(nova2_w))
    arm = {name: value for name, value in model.metadata["arm"].items() if name != missing}
    save_energy(replace(model, metadata={**model.metadata, "arm": arm}), tmp_path / "arm.safetensors")
    with pytest.raises(ModelError, match=f"another {missing.replace('_', '-')}"):
        load_arm_energy(tmp_path / "arm.safetensors", nova2_w)


def test_an_arm_of_few_joints_has_no_energy_of_its_own(tmp_path):
    text = "<robot name='short'><link name='l0'/>"
    for i in range(4):
        text += (
            f"<link name='l{i + 1}'/><joint name='j{i}' type='revolute'><parent link='l{i}'/><child link='l{i + 1}'/>"
            "<origin xyz='0.1 0 0.3'/><axis xyz='0 0 1'/><limit lower='-1' upper='1' velocity='1' effort='1'/></joint>"
        )
    (tmp_path / "short.urdf").write_text(text + "</robot>")
    (tmp_path / "cell.toml").write_text(
        "schema = 1\n[robot]\nmodel = 'short.urdf'\n[end_effector]\nmodel = 'w'\n[table]\ncenter = [0, 0]\n"
        "size = [1.8, 1.8]\n[workspace]\nx = [0.25, 0.6]\ny = [-0.4, 0.4]\n"
    )
    with pytest.raises(ModelError, match=r"'short' has 4 joints .* plan with refiner 'exact'"):
        train_arm_energy(load_workcell(tmp_path / "cell.toml"), out=tmp_path / "arm.safetensors")


def test_an_arm_below_every_support_says_so(tmp_path):
    text = BUILT_IN.format(height=0.0, effector="w").replace(
        "position = [0.0, 0.0, 0.0]", "position = [0.0, 0.0, -3.0]"
    )
    (tmp_path / "deep.toml").write_text(text)
    with pytest.raises(ModelError, match="below the lowest support"):
        train_arm_energy(load_workcell(tmp_path / "deep.toml"), out=tmp_path / "arm.safetensors", jobs=1)
