"""Prepared models: made, found, used; and refused when they are broken, incomplete or made for something else."""

import json
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, load_object, load_workcell, prepare, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import GraspError, ModelError, OptionError, RegraspError
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.planning import prepare as prepare_module
from regrasp_opt.planning.arm_energy import find_arm_energy
from regrasp_opt.planning.model_key import ModelKey
from regrasp_opt.planning.model_store import bundled_models, command_arguments, find_model
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.scene import Clearance, WorkspaceBounds

FILES = {"grasps.npz", "energy.safetensors", "energy-paper.safetensors", "report.json"}
SMALL = {"samples": 300, "num_grasps": 25, "jobs": 1}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """Return the folder and the report of a small model of the pentagon, the progress it told, and the seconds."""
    told, began = [], time.perf_counter()
    out = tmp_path_factory.mktemp("models") / "pentagon"
    folder, report = prepare(
        load_object("pentagon"), load_workcell("nova2-w"), out=out, progress=lambda *step: told.append(step), **SMALL
    )
    assert folder == out
    return folder, report, told, time.perf_counter() - began


@pytest.fixture
def copied(prepared, tmp_path):
    """Return a copy of the small model that a test may damage."""
    return shutil.copytree(prepared[0], tmp_path / "model")


def load(folder):
    return RegraspProblem.load("pentagon", "nova2-w", model=folder)


def refusal(folder, error=ModelError):
    with pytest.raises(error) as info:
        _ = load(folder).energy
    message = str(info.value)
    assert "\n" not in message and str(folder) in message and len(message) < 400
    return message


def test_prepare_writes_a_model_and_says_how_good_it_is(prepared):
    folder, report, told, seconds = prepared
    assert {path.name for path in folder.iterdir()} == FILES
    assert json.loads((folder / "report.json").read_text("utf-8")) == {"format": 1, **report}
    assert report["object"] == "pentagon" and report["workcell"] == "nova2-w"
    assert report["feasible_pairs"] >= 300 and report["pairs"] > report["feasible_pairs"]
    for preset in ("default", "paper"):
        figures = report["held_out"][preset]
        assert 0.5 < figures["average_precision"] <= 1 and 0.3 < figures["f1"] <= 1
        assert np.isfinite(report["threshold"][preset])
    assert "regrasp-opt prepare nova2-w --object pentagon" in report["command"]
    assert set(report["times"]) == {"grasps", "labelling", "training"}
    assert min(report["times"].values()) > 0 and sum(report["times"].values()) <= seconds
    assert told[0] == ("sampling grasps", 0, 1)
    assert ("labelling", 300, 300) in told and told[-1] == ("training", 2, 2)


def test_a_prepared_model_plans(prepared):
    problem = load(prepared[0])
    assert len(problem.grasps) == prepared[1]["grasps"]
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(problem, task.start, task.goal)
    assert plan.solved and plan.num_regrasps >= 1
    assert plan.residuals().hold


def test_the_same_seed_prepares_the_same_model(prepared, tmp_path):
    again, _ = prepare(load_object("pentagon"), load_workcell("nova2-w"), out=tmp_path / "again", **SMALL)
    for name in ("grasps.npz", "energy.safetensors", "energy-paper.safetensors"):
        assert (again / name).read_bytes() == (prepared[0] / name).read_bytes()


def test_by_default_a_model_is_kept_where_problems_find_it(tmp_path, monkeypatch):
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path))
    problem = RegraspProblem.load("pentagon", "nova2-r85")
    assert problem.model_folder is None
    with pytest.raises(ModelError, match="regrasp-opt prepare nova2-r85 --object pentagon"):
        _ = replace(problem, preset="paper").energy
    folder, _ = prepare(load_object("pentagon"), load_workcell("nova2-r85"), **SMALL)
    assert tmp_path in folder.parents
    again = RegraspProblem.load("pentagon", "nova2-r85")
    assert again.model_folder == folder and len(again.energy) == len(again.grasps)


@pytest.mark.parametrize(
    "step", ["sample_grasps", "label_pairs", "label_poses", "calibrate", "save_energy", "write_report"]
)
def test_an_interrupted_prepare_leaves_no_half_model(step, tmp_path, monkeypatch):
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path / "home"))
    before = getattr(prepare_module, step)
    calls = []

    def interrupted(*args, **options):
        calls.append(step)
        if step != "save_energy" or len(calls) == 2:
            raise KeyboardInterrupt
        return before(*args, **options)

    monkeypatch.setattr(prepare_module, step, interrupted)
    with pytest.raises(KeyboardInterrupt):
        prepare(load_object("pentagon"), load_workcell("nova2-w"), out=tmp_path / "model", **SMALL)
    assert not (tmp_path / "model" / "report.json").exists()
    with pytest.raises(ModelError, match="holds no prepared model"):
        load(tmp_path / "model")
    assert not list(tmp_path.glob("**/.*"))


def test_an_interrupted_second_prepare_mixes_nothing(copied, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(prepare_module, "save_energy", interrupted)
    before = load(copied)
    grasps, energy = before.grasps.fingerprint(), before.energy.fingerprint()
    with pytest.raises(KeyboardInterrupt):
        prepare(load_object("pentagon"), load_workcell("nova2-w"), out=copied, seed=1, **SMALL)
    try:
        after = load(copied)
    except ModelError:
        return
    assert (after.grasps.fingerprint(), after.energy.fingerprint()) == (grasps, energy)


@pytest.mark.parametrize("options", [{"samples": 99}, {"samples": -1}, {"num_grasps": 0}, {"seed": -1}])
def test_prepare_refuses_options_outside_their_range(options, tmp_path):
    with pytest.raises(OptionError):
        prepare(load_object("pentagon"), load_workcell("nova2-w"), out=tmp_path / "model", **{**SMALL, **options})
    assert not list(tmp_path.iterdir())


def test_prepare_refuses_an_object_that_no_grasp_fits(tmp_path):
    with pytest.raises(GraspError, match="fits object 'bottle'"):
        prepare(load_object("bottle", scale=8.0), load_workcell("nova2-w"), out=tmp_path / "model", **SMALL)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", sorted(FILES))
@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "garbage"])
def test_broken_files_are_refused(copied, name, damage):
    path = copied / name
    whole = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "cut": whole[: len(whole) // 2], "garbage": b"\x93garbage" * 40}[damage])
    if name == "energy-paper.safetensors":
        with pytest.raises(ModelError) as info:
            _ = RegraspProblem.load("pentagon", "nova2-w", model=copied, preset="paper").energy
        assert str(copied) in str(info.value)
        assert len(load(copied).energy) > 0
    else:
        refusal(copied, RegraspError)


@pytest.mark.parametrize("text", ["null", "[]", "{}", '{"format": 1}', '{"format": 99, "key": "x"}'])
def test_reports_that_are_none_are_refused(copied, text):
    (copied / "report.json").write_text(text, encoding="utf-8")
    assert "report" in refusal(copied)


def test_a_folder_that_is_none_is_refused(tmp_path):
    assert "holds no prepared model" in refusal(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("other", "said"), [(("mug", "nova2-w"), "object"), (("pentagon", "nova2-r140"), "end-effector")]
)
def test_a_model_of_something_else_is_refused(copied, other, said):
    with pytest.raises(ModelError, match=f"was prepared for another {said} than"):
        RegraspProblem.load(*other, model=copied)
    report = json.loads((copied / "report.json").read_text("utf-8"))
    for made_for in (None, 3):  # as if written before reports had it, and damaged
        (copied / "report.json").write_text(json.dumps(report | {"made_for": made_for}), encoding="utf-8")
        with pytest.raises(ModelError, match="was prepared for another object or workcell than"):
            RegraspProblem.load(*other, model=copied)
        assert load(copied).model_folder == copied


def test_a_key_tells_the_arm_from_its_scene():
    body, cell = load_object("bottle"), load_workcell("nova2-w")
    key = ModelKey.of(body, cell)
    box = Box("box", np.full(3, 0.1), translation(0.4, 0.6, 0.05))
    others = {
        "surroundings": replace(cell, obstacles=(box,)),
        "workspace": cell.within(WorkspaceBounds((-0.3, 0.3), (0.2, 0.5))),
        "clearance": replace(cell, clearance=Clearance(arm=0.01)),
        "mounting": replace(cell, arm=replace(cell.arm, T_world_base=translation(0.0, 0.0, 0.01))),
        "end-effector": load_workcell("nova2-w", end_effector="r85"),
    }
    for part, other in others.items():
        assert key.differing({"made_for": ModelKey.of(body, other).parts()}) == [part]
    assert ModelKey.of(body, cell.with_obstacles([box])) == key  # put in afterwards: no other model is needed
    assert ModelKey.of(load_object("mug"), cell).differing({"made_for": key.parts()}) == ["object"]


@pytest.mark.parametrize("name", ["bottle", "mug", "pentagon", "figurine"])
def test_bundled_models_tell_what_they_were_made_for(name):
    report = json.loads((bundled_models() / f"{name}-nova2-w" / "report.json").read_text("utf-8"))
    key = ModelKey.of(load_object(name), load_workcell("nova2-w"))
    assert report["key"] == key.id and report["made_for"] == key.parts()
    assert find_model(load_object(name), load_workcell("nova2-w")) == bundled_models() / f"{name}-nova2-w"


def test_files_of_another_model_are_refused(copied):
    stranger = bundled_models() / "mug-nova2-w"
    shutil.copy(stranger / "energy.safetensors", copied)
    assert "trained for another object or workcell" in refusal(copied)
    shutil.copy(stranger / "grasps.npz", copied)
    assert "grasps" in refusal(copied)


@pytest.mark.parametrize("name", ["bottle", "mug", "pentagon", "figurine"])
def test_bundled_models_are_whole_small_and_good(name):
    folder = bundled_models() / f"{name}-nova2-w"
    problem = RegraspProblem.load(name, "nova2-w")
    assert problem.model_folder == folder
    assert {path.name for path in folder.iterdir()} == FILES
    assert sum(path.stat().st_size for path in folder.iterdir()) < 300_000
    report = json.loads((folder / "report.json").read_text("utf-8"))
    assert report["held_out"]["default"]["average_precision"] >= 0.98
    assert report["held_out"]["paper"]["average_precision"] > 0.8
    assert report["command"].startswith(f"regrasp-opt prepare nova2-w --object {name}")
    assert len(problem.energy) == len(problem.grasps) == 200


def test_the_command_that_prepares_names_all_that_the_problem_was_loaded_with(tmp_path):
    mesh = tmp_path / "two words.stl"
    load_object("pentagon").mesh.export(mesh)
    body = replace(load_object(mesh, scale=0.5, repair=True), thickness=0.001)
    cell = load_workcell("nova2-w", end_effector="r85")
    assert command_arguments(load_object("pentagon"), load_workcell("nova2-s1")) == "nova2-s1 --object pentagon"
    wanted = f"nova2-w --end-effector r85 --object '{mesh}' --scale 0.5 --repair --thickness 0.001"
    assert command_arguments(body, cell) == wanted


def test_names_too_long_for_a_file_have_no_bundled_model():
    cell, body = load_workcell("nova2-w"), load_object("bottle")
    name = "x" * 300
    assert find_model(body, replace(cell, name=name)) is None
    robot = replace(cell.robot, name=name)
    assert find_arm_energy(replace(cell, arm=replace(cell.arm, robot=robot))) is None
