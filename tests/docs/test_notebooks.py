"""Every notebook in `examples/` runs from top to bottom in an empty folder, and shows pages where it promises them."""

import ast
import html
import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[2] / "examples"


def read(name):
    return json.loads((NOTEBOOKS / name).read_text(encoding="utf-8"))


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Return a function that runs the cells of a notebook, as Jupyter does, and returns what is printed and shown."""
    monkeypatch.chdir(tmp_path)

    def cells(name):
        names, shown = {"__name__": "__main__"}, []
        for cell in read(name)["cells"]:
            if cell["cell_type"] != "code":
                continue
            source = "".join(cell["source"])
            body = ast.parse(source).body
            last = body.pop() if isinstance(body[-1], ast.Expr) and not source.endswith(";") else None
            exec(compile(ast.Module(body, []), name, "exec"), names)
            if last is not None:
                shown.append(eval(compile(ast.Expression(last.value), name, "eval"), names))
        return capsys.readouterr().out, [value for value in shown if value is not None]

    return cells


def title(shown):
    """Return the title of the page that a notebook shows."""
    page = html.unescape(re.fullmatch(r'<iframe srcdoc="([^"]*)".*</iframe>', shown._repr_html_())[1])
    return re.search("<title>(.*)</title>", page)[1]


def test_a_plan_is_shown_and_verified(run, tmp_path):
    text, (plan, residuals) = run("10_plan_and_look.ipynb")
    assert text.startswith("solved: ") and len(re.findall(r"^move \d: \d+ grasps", text, re.M)) == 2
    assert title(plan) == "bottle in nova2-w" and residuals.hold
    assert (tmp_path / "plan.json").is_file()


def test_an_own_mesh_is_planned_around_an_obstacle(run):
    text, (around,) = run("11_own_mesh_and_obstacles.ipynb")
    assert text.count("solved: ") == 2 and "placement 4" in text
    assert title(around) == "bracket in nova2-w"
    assert [o.name for o in around.problem.workcell.obstacles] == ["post"] and around.residuals().hold


def test_plans_go_over_several_supports(run):
    text, (plan,) = run("12_several_supports.ipynb")
    assert text.count("solved: ") == 2 and "on the table" in text and "on the shelf" in text
    assert [station.support for station in plan.stations] == ["table", "table", "shelf"]
    assert title(plan) == "bottle in shelf"


def test_a_motion_is_shown_and_exported(run, tmp_path):
    text, (motion,) = run("13_motion_and_export.ipynb")
    assert text.startswith("solved: ")
    assert len(re.findall(r"^ *[\d.]+ s  move \d: ", text, re.M)) == len(motion.segments)
    assert title(motion) == "bottle in nova2-w"
    assert "joint_names" in (tmp_path / "motion.yaml").read_text(encoding="utf-8")
    assert (tmp_path / "scene.yaml").is_file() and (tmp_path / "motion.csv").is_file()


def test_a_failure_is_explained_and_its_advice_followed(run):
    text, (failed, plan) = run("14_why_not.ipynb")
    assert text.startswith("no grasp is feasible at the start pose") and "obstacle 'lid'" in text
    assert not failed.solved and plan.solved
    assert title(failed) == title(plan) == "bottle in nova2-w"


def test_every_notebook_has_a_test_says_how_to_run_it_and_stores_no_output():
    tested = Path(__file__).read_text(encoding="utf-8")
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        assert f'run("{path.name}")' in tested
        content = read(path.name)
        assert f"`jupyter lab examples/{path.name}`" in "".join(content["cells"][0]["source"])
        assert (content["nbformat"], content["nbformat_minor"]) == (4, 5)
        code = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
        assert code and all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
        names = [cell["id"] for cell in content["cells"]]
        assert len(set(names)) == len(names)
