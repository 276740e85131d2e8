"""The commands from outside: exit codes, what is printed where, what is written."""

import json
import re
from importlib.metadata import PackageNotFoundError, version
from typing import get_type_hints

import numpy as np
import pytest
from command import as_process, assert_refused, in_process

from regrasp_opt.cli.app import app, run

KEYS = ["status", "num_regrasps", "cost", "poses", "transitions", "timings"]
ENDS = ("--start", "0:0.2,0.35,30", "--goal", "0:-0.2,0.35,210")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Return the file of the plan that is made without any argument."""
    path = tmp_path_factory.mktemp("cli") / "plan.json"
    assert run(["plan", "--out", str(path)]) == 0
    return path


def test_plan_without_arguments_needs_a_regrasp(tmp_path):
    outcome = as_process("plan", cwd=tmp_path)
    assert outcome.code == 0 and outcome.err == ""
    assert outcome.out.startswith("solved: ")
    assert int(re.search(r"(\d+) regrasp\(s\)", outcome.out).group(1)) >= 1
    assert list(tmp_path.iterdir()) == []


def test_plan_as_json_is_one_object_with_the_keys_of_the_contract(capsys):
    outcome = in_process(capsys, "plan", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    assert list(outcome.data) == KEYS
    assert outcome.data["status"] == "solved" and outcome.data["num_regrasps"] >= 1
    assert np.shape(outcome.data["poses"]) == (outcome.data["num_regrasps"] + 2, 4, 4)
    assert len(outcome.data["transitions"]) == outcome.data["num_regrasps"] + 1


def test_the_same_seed_prints_the_same_plan(capsys):
    first, again, other = (
        in_process(capsys, "plan", "--object", "mug", "--seed", seed, "--json").data for seed in (3, 3, 4)
    )
    assert first.pop("timings") and again.pop("timings")
    assert first == again
    assert first["poses"] != other["poses"]


def test_a_direct_plan_between_given_ends(capsys):
    outcome = in_process(capsys, "plan", *ENDS, "--json")
    assert outcome.code == 0 and outcome.data["status"] == "solved"
    np.testing.assert_allclose(np.array(outcome.data["poses"])[[0, -1], :2, 3], [[0.2, 0.35], [-0.2, 0.35]], atol=0.2)


def test_a_pose_from_a_file_is_the_same_as_the_short_form(capsys, tmp_path):
    short = in_process(capsys, "plan", *ENDS, "--json").data
    path = tmp_path / "start.json"
    path.write_text(json.dumps(short["poses"][0]), encoding="utf-8")
    long = in_process(capsys, "plan", "--start", path, *ENDS[2:], "--json").data
    np.testing.assert_allclose(long["poses"], short["poses"], atol=1e-9)


def test_no_plan_is_exit_code_1(capsys):
    outcome = in_process(capsys, "plan", "--max-regrasps", 0, "--json")
    assert outcome.code == 1 and outcome.err == ""
    assert outcome.data["status"] == "not_found" and outcome.data["cost"] is None
    assert outcome.data["transitions"] == []
    said = in_process(capsys, "plan", "--max-regrasps", 0)
    assert said.code == 1 and said.out.startswith("not_found: ")
    late = in_process(capsys, "plan", "--time-limit", 1e-6, "--json")
    assert late.code == 1 and late.data["status"] == "time_limit"


@pytest.mark.parametrize("refiner", ["ipopt", "lattice"])
def test_refiners_by_name(capsys, refiner):
    assert in_process(capsys, "plan", "--refiner", refiner, "--json").data["status"] == "solved"


def test_check_verifies_a_saved_plan(capsys, saved):
    outcome = in_process(capsys, "check", saved)
    assert outcome.code == 0 and outcome.err == "" and "holds" in outcome.out
    data = in_process(capsys, "check", saved, "--json").data
    assert data["holds"] is True and data["problems"] == []
    assert len(data["transitions"]) == len(json.loads(saved.read_text("utf-8"))["transitions"])


@pytest.mark.parametrize("transition", [0, -1])
def test_check_names_the_transition_of_a_changed_joint(capsys, saved, tmp_path, transition):
    content = json.loads(saved.read_text("utf-8"))
    content["transitions"][transition]["q_place"][0][4] += 0.1
    number = transition % len(content["transitions"])
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    outcome = in_process(capsys, "check", path)
    assert outcome.code == 1 and "Traceback" not in outcome.out + outcome.err
    assert f"does not hold: transition {number}:" in outcome.out
    data = in_process(capsys, "check", path, "--json")
    assert data.code == 1 and data.data["holds"] is False
    assert all(text.startswith(f"transition {number}:") for text in data.data["problems"])


def test_check_of_a_plan_that_is_not_solved(capsys, tmp_path):
    path = tmp_path / "plan.json"
    assert in_process(capsys, "plan", "--max-regrasps", 0, "--out", path).code == 1
    outcome = in_process(capsys, "check", path, "--json")
    assert outcome.code == 1 and outcome.data["problems"] == ["the plan is not solved: not_found"]


def test_the_page_needs_no_network(capsys, tmp_path):
    page = tmp_path / "plan.html"
    assert in_process(capsys, "plan", "--html", page).code == 0
    text = page.read_text("utf-8")
    assert text.startswith("<html") or "<!doctype html" in text[:200].lower()
    tags = re.findall(r"<(?:script|link|img|iframe)\b[^>]*>", text.split("<body", 1)[0] + text[-200_000:])
    assert not [tag for tag in tags if re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", tag)]
    assert not re.search(r"<script[^>]*\ssrc=", text)
    assert "figurine" not in text and "bottle in nova2-w" in text
    assert [path.name for path in tmp_path.iterdir()] == ["plan.html"]


def test_prepare_then_plan(capsys, tmp_path):
    folder = tmp_path / "model"
    options = ("--samples", 300, "--grasps", 20, "--jobs", 1, "--out", folder)
    outcome = in_process(capsys, "prepare", "nova2-w", "--object", "pentagon", *options, "--json")
    assert outcome.code == 0 and outcome.data["folder"] == str(folder)
    assert outcome.data["held_out"]["default"]["average_precision"] > 0.5
    assert in_process(capsys, "plan", "--object", "pentagon", "--model", folder, "--json").data["status"] == "solved"
    said = in_process(capsys, "prepare", "nova2-w", "--object", "pentagon", *options)
    assert said.code == 0 and said.out.startswith("prepared pentagon for nova2-w: 20 grasps")
    assert "AP" in said.out and "paper" in said.out


def test_help_everywhere(capsys):
    assert {"plan", "prepare", "check", "export"} <= set(in_process(capsys, "--help").out.split())
    for command in ("plan", "prepare", "check", "export"):
        outcome = in_process(capsys, command, "--help")
        assert outcome.code == 0 and "Usage" in outcome.out and outcome.err == ""


@pytest.mark.parametrize("command", [command.callback for command in app.registered_commands], ids=lambda c: c.__name__)
def test_help_shows_every_text_with_its_units_in_brackets(capsys, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "300")
    out = in_process(capsys, command.__name__, "--help").out
    hints = get_type_hints(command, include_extras=True).values()
    said = [part.help for hint in hints for part in getattr(hint, "__metadata__", ())]
    assert len(said) > 1
    assert [text for text in said if text.replace("\\[", "[") not in out] == []
    assert "\\" not in out


def test_no_arguments_at_all_show_the_help(capsys):
    assert in_process(capsys) == in_process(capsys, "--help")


def test_version(capsys):
    try:
        expected = version("regrasp-opt")
    except PackageNotFoundError:
        pytest.skip("the package is not installed")
    assert in_process(capsys, "--version").out == f"regrasp-opt {expected}\n"


# ---- bad input


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("plan", "--object", "botle"), "unknown object 'botle'; known: bottle, "),
        (("plan", "--workcell", "nova2-r8"), "unknown workcell 'nova2-r8'; known: nova2-r85, "),
        (("plan", "--end-effector", "r84"), "unknown end-effector 'r84'; known: r85, "),
        (("plan", "--refiner", "ipot"), "unknown refiner 'ipot'; known: ipopt, "),
        (("prepare", "nova2-w", "--object", "mugg"), "unknown object 'mugg'; known: mug, "),
        (("export", "botle-nova2-w", "--to", "c"), "unknown model 'botle-nova2-w'; known: bottle-nova2-w, "),
        (("plan", "--object", "none.stl"), "none.stl does not exist"),
        (("plan", "--workcell", "none.toml"), "none.toml cannot be read"),
        (("plan", "--model", "none"), "'none' holds no prepared model"),
        (("plan", "--start", "none.json"), "cannot read the start from 'none.json'"),
        (("plan", "--start", "somewhere"), "the start 'somewhere' is not a pose"),
        (("plan", "--goal", "9:0.2,0.3,0"), "the goal names placement 9; this object has placements 0 to 4"),
        (("plan", "--goal", "0:nan,0.3,0"), "holds NaN"),
        (("plan", "--goal", "0:a,0.3,0"), "is not a number"),
        (("plan", "--start", "0:0.9,0.3,0"), "the start pose is outside the workspace"),
        (("plan", "--max-regrasps", "-1"), "max_regrasps is -1"),
        (("plan", "--max-regrasps", "9"), "max_regrasps is 9"),
        (("plan", "--max-regrasps", "two"), "--max-regrasps"),
        (("plan", "--time-limit", "0"), "time_limit is 0"),
        (("plan", "--time-limit", "nan"), "time_limit is nan"),
        (("plan", "--seed", "-1"), "seed is -1"),
        (("plan", "--scale", "0"), "scale is 0"),
        (("plan", "--scale", "nan"), "scale is nan"),
        (("plan", "--colour", "red"), "--colour"),
        (("plan", "extra"), "extra"),
        (("plan", "--out", ""), "an argument is empty"),
        (("plan", "--start="), "an argument is empty"),
        (("prepare",), "WORKCELL"),
        (("prepare", "nova2-w", "--object", "mug", "--samples", "5"), "samples is 5"),
        (("prepare", "nova2-w", "--samples", "500"), "--samples has no meaning for the energy of an arm"),
        (("prepare", "nova2-w", "--repair"), "--repair has no meaning for the energy of an arm"),
        (("prepare", "nova2-w", "--object", "mug", "--poses", "5000"), "--poses has no meaning for the energy of an"),
        (("prepare", "nova2-w", "--object", "mug", "--grasps", "0"), "num_grasps 0"),
        (("check",), "PLAN"),
        (("check", "none.json"), "cannot read the plan 'none.json'"),
        (("check", "."), "cannot read the plan"),
        (("export", "bottle-nova2-w"), "--to"),
        (("export", "bottle-nova2-w", "--to", "pdf"), "pdf"),
        (("export", ".", "--to", "c"), ""),
        (("fly",), "fly"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)  # fmt: skip
def test_bad_input_is_one_line_and_exit_code_2(capsys, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert_refused(in_process(capsys, *arguments), said)
    assert list(tmp_path.iterdir()) == []


def test_bad_input_in_a_process_of_its_own(tmp_path):
    assert_refused(as_process("plan", "--object", "botle", cwd=tmp_path), "known: bottle")
    assert_refused(as_process("check", "none.json", cwd=tmp_path), "none.json")
    debug = as_process("--debug", "plan", "--object", "botle", cwd=tmp_path)
    assert debug.code == 2 and "Traceback" in debug.err and debug.err.splitlines()[-1].startswith("error: ")


@pytest.mark.parametrize(
    "arguments",
    [("plan", "--out"), ("plan", "--html"), ("export", "bottle-nova2-w", "--to", "c", "--out")],
    ids=" ".join,
)
def test_a_place_that_cannot_be_written(capsys, tmp_path, arguments):
    blocker = tmp_path / "file"
    blocker.write_text("kept", encoding="utf-8")
    outcome = in_process(capsys, *arguments, blocker / "inside")
    assert_refused(outcome, str(blocker))
    folder = tmp_path / "folder"
    (folder / "inside").mkdir(parents=True)
    assert in_process(capsys, *arguments, folder).code == 2
    assert blocker.read_text("utf-8") == "kept"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder", "inside"]


def test_prepare_into_a_place_that_cannot_be_written(capsys, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("kept", encoding="utf-8")
    options = ("--samples", 300, "--grasps", 20, "--jobs", 1, "--out", blocker / "model")
    assert_refused(in_process(capsys, "prepare", "nova2-w", "--object", "pentagon", *options), str(blocker))
    assert blocker.read_text("utf-8") == "kept"


@pytest.mark.parametrize("damage", ["", "[1, 2", "[]", "null", '{"a": 1}', "[[1, 0], [0, 1]]", "[[1e999]]"])
def test_pose_files_that_hold_no_pose(capsys, tmp_path, damage):
    path = tmp_path / "start.json"
    path.write_text(damage, encoding="utf-8")
    assert_refused(in_process(capsys, "plan", "--start", path), str(path))


def test_meshes_that_are_no_solid(capsys, tmp_path):
    path = tmp_path / "part.stl"
    for content in (b"", b"solid part\nendsolid part\n", b"\x00" * 84, b"junk" * 100):
        path.write_bytes(content)
        assert_refused(in_process(capsys, "plan", "--object", path), "part.stl")
        assert_refused(in_process(capsys, "prepare", "nova2-w", "--object", path), "part.stl")
