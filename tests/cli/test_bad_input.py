"""Bad input from outside, one class after another: what is said, exit code 2, and that no file is lost or added."""

import json
import shutil

import numpy as np
import pytest
import trimesh
from command import assert_refused, in_process
from oracles.files import DATA

from regrasp_opt.cli import prepare as prepare_command
from regrasp_opt.conventions import translation

CELL = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
CRATE = '\n[[obstacles]]\ntype = "box"\nname = "crate"\nposition = [0.24, 0.35, 0.05]\nsize = [0.04, 0.04, 0.1]\n'
ARM = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8")
FREE = translation(-0.2, 0.35, 0.0)
NAN, SHEARED, MIRRORED, ODD = FREE.copy(), FREE.copy(), FREE.copy(), FREE.copy()
NAN[0, 3] = np.nan
SHEARED[0, 1] = 0.1
MIRRORED[0, 0] = -1.0
ODD[3, 0] = 0.5

PREPARE = "prepare", "nova2-w", "--object", "pentagon"


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture
def refuse(tmp_path, capsys, monkeypatch):
    """Return a check that a command is refused and leaves every file in the working folder as it was."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path / "home"))
    (tmp_path / "plan.json").write_text("the plan of yesterday", encoding="utf-8")

    def check(said, *arguments):
        before = contents(tmp_path)
        assert_refused(in_process(capsys, *arguments), said)
        assert contents(tmp_path) == before

    return check


POSES = {
    "nan": (NAN, "holds NaN or infinity"),
    "not rigid": (SHEARED, "is not a rigid transform"),
    "last row": (ODD, "is not a rigid transform"),
    "left-handed": (MIRRORED, "is left-handed"),
    "floats": (translation(0.2, 0.35, 0.02), "floats 20.0 mm above the table"),
    "sinks": (translation(0.2, 0.35, -0.02), "sinks 20.0 mm into the table"),
    "outside": (translation(0.2, 0.9, 0.0), "pose is outside the workspace"),
}


@pytest.mark.parametrize("end", ["start", "goal"])
@pytest.mark.parametrize("name", POSES)
def test_poses_that_cannot_be(refuse, tmp_path, name, end):
    pose, said = POSES[name]
    other = {"start": "goal", "goal": "start"}[end]
    for key, T in ((end, pose), (other, FREE)):
        (tmp_path / f"{key}.json").write_text(json.dumps(T.tolist()), encoding="utf-8")
    refuse(said, "plan", "--start", "start.json", "--goal", "goal.json", "--out", "plan.json", "--html", "plan.html")


def test_an_end_in_an_obstacle_or_out_of_reach(refuse, tmp_path):
    (tmp_path / "crate.toml").write_text(CELL + CRATE, encoding="utf-8")
    ends = ("--start", "0:0.22,0.35,0", "--goal", "0:-0.2,0.35,0", "--out", "plan.json")
    refuse("overlaps the obstacle 'crate' at the start pose", "plan", "--workcell", "crate.toml", *ends)
    wide = CELL.replace("size = [1.4, 1.2]", "size = [4.0, 4.0]").replace("y = [0.1, 0.6]", "y = [0.1, 2.0]")
    (tmp_path / "wide.toml").write_text(wide, encoding="utf-8")
    ends = ("--start", "0:-0.2,0.35,0", "--goal", "0:0,1.9,0", "--out", "plan.json")
    refuse("the goal pose is out of reach", "plan", "--workcell", "wide.toml", *ends)


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (trimesh.creation.box((0.3, 0.3, 0.3)), "fits object 'part'"),
        (trimesh.creation.icosphere(subdivisions=4, radius=0.03), "'part' has no stable placement"),
    ],
    ids=["no grasp", "no placement"],
)
def test_objects_that_cannot_be_handled(refuse, tmp_path, shape, said):
    shape.export(tmp_path / "part.stl")
    refuse(said, "prepare", "nova2-w", "--object", "part.stl", "--samples", 300, "--jobs", 1, "--out", "model")
    refuse(said, "plan", "--object", "part.stl", "--out", "plan.json")


@pytest.mark.parametrize("name", ["energy.safetensors", "grasps.npz", "report.json"])
@pytest.mark.parametrize("content", [b"", b"\x00junk" * 50], ids=["empty", "corrupt"])
def test_broken_models(refuse, tmp_path, name, content):
    shutil.copytree(DATA / "models" / "bottle-nova2-w", tmp_path / "model")
    (tmp_path / "model" / name).write_bytes(content)
    refuse("corrupt", "plan", "--model", "model", "--out", "plan.json")
    if name != "report.json":
        refuse("corrupt", "export", "model", "--to", "casadi", "--out", "energy.casadi")


def test_a_robot_that_collides_with_itself_at_home(refuse, tmp_path):
    folded = CELL.replace('model = "nova2"', 'model = "nova2"\nhome = [0, 0, 2.618, 1.5, 0, 0]')
    (tmp_path / "cell.toml").write_text(folded, encoding="utf-8")
    said = "'link1' collides with 'link5', or is nearer than its clearance, while the robot is at home"
    refuse(said, "plan", "--workcell", "cell.toml", "--out", "plan.json")
    refuse(said, "prepare", "cell.toml", "--object", "bottle", "--out", "model")


def test_numbers_and_names_that_are_none(refuse):
    refuse("max_regrasps is -1", "plan", "--max-regrasps", -1, "--out", "plan.json")
    refuse("unknown object 'botle'; known: bottle, ", "plan", "--object", "botle", "--out", "plan.json")
    refuse("unknown experiment 'one-stp'; known: one-step, ", "bench", "one-stp", "--out", "results")


def test_more_samples_than_fit_into_memory(refuse):
    refuse(
        "ask for fewer samples",
        "prepare",
        "nova2-w",
        "--object",
        "pentagon",
        "--samples",
        10**13,
        "--jobs",
        1,
        "--out",
        "model",
    )


def test_running_out_of_memory_is_one_line(refuse, monkeypatch):
    monkeypatch.setattr(prepare_command, "prepare", lambda *_, **__: np.zeros(2**57))
    refuse("there is not enough memory", *PREPARE, "--out", "model")


def test_a_folder_of_broken_meshes(refuse, tmp_path):
    (tmp_path / "meshes").mkdir()
    refuse("holds no mesh", "bench", "one-step", "--objects", "meshes", "--out", "results")
    refuse("is not a folder", "bench", "one-step", "--objects", "none", "--out", "results")


def test_plans_and_motions_that_cannot_be_read(refuse, tmp_path):
    (tmp_path / "cut.json").write_text('{"schema": 1, "status":', encoding="utf-8")
    refuse("is not valid JSON", "check", "cut.json")
    refuse("is not valid JSON", "motion", "cut.json", "--out", "motion.json")
    refuse("is not valid JSON", "show", "cut.json", "--html", "page.html")
