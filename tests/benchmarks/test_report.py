import json
import re
from dataclasses import replace

import plotly.graph_objects as go
import pytest

from regrasp_opt.benchmarks.harness.report import (
    Figure,
    Report,
    Table,
    mean,
    percent,
    shown,
    write_document,
    write_report,
)


@pytest.fixture
def report():
    table = Table("Shares <&>", ("object", "ours", "paper"), (("bottle", 97.5, None), ("mug", 100.0, 70.8)), "A note.")
    rows = [{"object": "bottle", "sv": 0.975}, {"object": "cup.stl", "error": "no solid"}]
    figure = Figure("A curve", go.Figure(go.Scatter(x=[0, 1], y=[2, 3])))
    return Report(
        "one-step", "One step", "What it is.", (table,), rows, (figure,), {"bottle": "abc"}, ("r1",), {"seed": 0}
    )


def test_the_summary_says_what_how_and_on_what(report, tmp_path):
    write_report(report, tmp_path / "one-step")
    summary = json.loads((tmp_path / "one-step" / "summary.json").read_text(encoding="utf-8"))
    assert summary["instances"] == {"bottle": "abc"} and summary["revisions"] == ["r1"] and summary["rows"] == 2
    assert summary["settings"] == {"seed": 0} and summary["environment"]["versions"]["numpy"][0].isdigit()
    assert summary["errors"] == [{"object": "cup.stl", "error": "no solid"}]
    assert summary["tables"][0]["rows"] == [["bottle", 97.5, None], ["mug", 100.0, 70.8]]


def test_the_page_is_one_file_that_needs_no_network(report, tmp_path):
    write_report(report, tmp_path)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Shares &lt;&amp;&gt;" in page and "<td>97.5</td>\n<td>-</td>" in page
    assert "<code>cup.stl</code>: no solid" in page
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)\s*=\s*['\"]?(?:https?:)?//", page)


def test_both_pages_say_the_same_and_how_they_were_made(report, tmp_path):
    write_report(replace(report, settings={"seed": 0, "quick": True}), tmp_path)
    text = (tmp_path / "one-step.md").read_text(encoding="utf-8")
    assert text.startswith("# One step\n\nThis page is written by `regrasp-opt bench one-step`.\n")
    assert "Command: `regrasp-opt bench one-step --quick`. Settings: seed 0, quick True. Code: r1." in text
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert (
        page.index("<h1>One step</h1>")
        < page.index("<p>A note.</p>")
        < page.index("<h2>A curve</h2>")
        < page.index("Plotly.newPlot")
    )


def test_the_document_collects_every_experiment(report, tmp_path):
    write_report(report, tmp_path / "one-step")
    (tmp_path / "older").mkdir()
    (tmp_path / "older" / "summary.json").write_text("{}", encoding="utf-8")
    write_document(tmp_path, tmp_path / "benchmarks.md")
    text = (tmp_path / "benchmarks.md").read_text(encoding="utf-8")
    assert "## One step" in text and "| bottle | 97.5 | - |" in text and "`cup.stl`: no solid" in text


def test_numbers_are_rounded_for_readers():
    assert percent([True, False, False]) == 33.3 and percent([]) is None
    assert mean([1.0, 2.0], 1) == 1.5 and mean([]) is None
    assert [shown(x) for x in (None, float("nan"), 1.50, 100.0, 3, "text")] == ["-", "-", "1.5", "100", "3", "text"]
