"""The tables of the documentation name everything that the code has: commands, keys, tolerances, layers."""

import re
from pathlib import Path

import pytest
import typer.main
from test_architecture import LAYERS

import regrasp_opt
from regrasp_opt import Status, conventions
from regrasp_opt.cli.app import app
from regrasp_opt.end_effectors import loading
from regrasp_opt.planning import plan_file
from regrasp_opt.scene import record, schema

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
COMMANDS = vars(typer.main.get_command(app))["commands"]


def read(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_command_and_its_options_are_documented(name):
    text = read("command-line.md")
    assert f"## `{name}`" in text
    section = text.split(f"## `{name}`")[1].split("\n## ")[0]
    for parameter in COMMANDS[name].params:
        if parameter.name == "help":
            continue
        shown = max(parameter.opts, key=len)
        shown = shown if shown.startswith("--") else parameter.metavar
        assert f"`{shown}`" in section, shown


def keys(section) -> set[str]:
    return {field.alias or name for name, field in section.model_fields.items()}


@pytest.mark.parametrize(
    "section",
    [
        schema.WorkcellFile,
        schema.WorkcellFile1,
        schema.ArmSection,
        schema.SupportSection,
        schema.HeldPoseSection,
        schema.RobotSection,
        schema.EndEffectorSection,
        schema.TableSection,
        schema.WorkspaceSection,
        schema.ClearanceSection,
        schema.ObstacleSection,
    ],
)
def test_every_key_of_a_workcell_is_documented(section):
    text = read("workcell-file.md")
    for key in keys(section):
        assert f"`{key}`" in text or f"`[{key}]`" in text or f"`[[{key}]]`" in text, key


def test_every_key_of_an_end_effector_is_documented():
    text = read("end-effector-file.md")
    for section in (loading._EndEffectorSchema, loading._BodySchema, loading._BoxSchema, loading._CylinderSchema):
        for key in keys(section):
            assert f"`{key}`" in text, key


@pytest.mark.parametrize("record", ["_File", "_Transition", "_Grasp", "_Object", "_Workcell", "_Workcell1"])
def test_every_key_of_a_plan_file_is_documented(record):
    text = read("plan-file.md")
    for key in keys(getattr(plan_file, record)):
        assert f"`{key}`" in text, key


def test_every_key_of_a_scene_is_documented():
    text = read("plan-file.md")
    for section in (record.ArmRecord, record.SupportRecord, record.ObstacleRecord, record.SceneRecord):
        for key in keys(section):
            assert f"`{key}`" in text, key


def test_every_status_is_documented():
    for status in Status:
        assert f"`{status.name.lower()}`" in read("plan-file.md")
        assert status is Status.SOLVED or f"`{status.name.lower()}`" in read("faq.md")


def test_the_tolerances_have_their_values():
    names = [name for name in vars(conventions) if name.endswith("_TOLERANCE")]
    documented = dict(re.findall(r"^\| `(\w+_TOLERANCE)` \| (\S+) ", read("conventions.md"), re.M))
    assert {name: float(value) for name, value in documented.items()} == {n: getattr(conventions, n) for n in names}


def test_the_picture_of_the_layers_is_the_code():
    picture = re.search(r"```text\n(.*?)```", read("architecture.md"), re.S)[1]
    drawn = [set(line.split()) for line in picture.splitlines() if line.strip() != "|"]
    present = {path.stem for path in (ROOT / "regrasp_opt").iterdir() if path.suffix in ("", ".py")}
    assert drawn == [layer & present for layer in LAYERS if layer & present]
    for layer in drawn:
        for name in layer:
            assert f"| `{name}` |" in read("architecture.md")


def test_every_public_name_is_in_the_reference():
    text = read("reference.md")
    for name in regrasp_opt.__all__:
        assert f"regrasp_opt.{name}\n" in text or name == "RegraspError", name
    assert "automodule:: regrasp_opt.errors" in text


def test_the_version_is_the_same_everywhere():
    patterns = {
        "pyproject.toml": r'^version = "(.+)"$',
        "CITATION.cff": r"^version: (.+)$",
        "docs/conf.py": r'^version = release = "(.+)"$',
    }
    found = {name: re.search(p, (ROOT / name).read_text(encoding="utf-8"), re.M)[1] for name, p in patterns.items()}
    assert len(set(found.values())) == 1, found
    assert f"## [{found['pyproject.toml']}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_constraints_are_exact_and_cover_the_dependencies():
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\d.]+(b\d+|\.post\d+)?", line) for line in lines)
    pinned = {re.sub(r"[-_.]+", "-", line.split("==")[0]).lower() for line in lines}
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8").split("[project.scripts]")[0]
    needed = re.findall(r'"([\w-]+)>=[\d.]+"', settings.split("dependencies = [", 1)[1])
    assert len(needed) > 20
    assert {re.sub(r"[-_.]+", "-", name).lower() for name in needed} <= pinned


def test_the_conda_recipe_asks_for_the_same_versions():
    recipe = (ROOT / ".ci" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    run = recipe[recipe.index("  run:") : recipe.index("tests:")]
    found = {other or name: low for name, low, other in re.findall(r"- ([\w.-]+) >=([\d.]+)(?: # (\w+))?", run)}
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    wanted = dict(re.findall(r'^    "([\w.-]+)>=([\d.]+)', project[: project.index("[project.optional")], re.M))
    wanted["python"] = re.search(r'requires-python = ">=(.+)"', project)[1]
    assert found == wanted


def test_the_first_page_installs_as_the_readme_does_and_has_a_gallery():
    page, readme = ((ROOT / name).read_text(encoding="utf-8") for name in ("docs/index.md", "README.md"))
    (command,) = re.findall(r"^```bash\n(.*)\n```$", page, re.M)
    assert f"```bash\n{command}\n```" in readme
    assert page.index(command) < page.index("| you want to | read |") < page.index("## Gallery")
    pictures, made = re.findall(r"\(images/([\w-]+)\.png\)", page), (DOCS / "make_images.py").read_text("utf-8")
    scenes = [path.stem for path in (ROOT / "docs/scenes").glob("*.toml")]
    assert len(pictures) > 6 and all(f'"{name}.png"' in made or name in scenes for name in pictures)
