"""The document begins with the results at a glance: figures of the tables below, ablations last."""

import json
import re
from pathlib import Path

import pytest

from regrasp_opt.benchmarks.harness.glance import HEADLINES, glance, in_order
from regrasp_opt.benchmarks.harness.report import Report, Table, write_document, write_report

PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"


def motions(*rows):
    columns = ("object", "pairs", "moves [%]", "both [s]")
    return {
        "name": "motion",
        "title": "Motion, and more",
        "tables": [dict(title="Motions", columns=columns, rows=rows)],
    }


def test_a_figure_is_a_value_or_a_range_over_the_rows():
    (line,) = glance([motions(("bottle", 50, 100.0, 0.5), ("mug", 50, 96.0, 0.91), ("cup", 50, None, float("nan")))])
    assert line[1] == "50 pairs; 96 to 100 % with a motion; half of plans with motions within 0.5 to 0.91 s"
    assert line[2] == "[Motion, and more](#motion-and-more)"


def test_only_the_rows_that_are_meant_count():
    columns = ("object", "pairs", "in all [%]", "verified [%]")
    rows = (("bottle", 25, 55.5, 100.0), ("all", 100, 52.4, 99.0))
    table = dict(title="The travel, lowered at equal N", columns=columns, rows=rows)
    (line,) = glance([{"name": "joint", "title": "Joint", "tables": [table]}])
    assert line[1] == "100 pairs; lowered by 52.4 % in the median; 99 % verified"


@pytest.mark.parametrize("summaries", [[], [motions()], [motions(("bottle", None, None, None))]])
def test_nothing_is_said_of_what_was_not_measured(summaries):
    assert glance(summaries) == []


def test_results_come_first_and_ablations_last():
    names = ["ablations", "arms", "cost-sweep", "joint", "refiners"]
    assert [s["name"] for s in in_order({"name": n} for n in names)] == [
        "refiners",
        "joint",
        "cost-sweep",
        "arms",
        "ablations",
    ]


def test_the_written_document_begins_with_the_results(tmp_path):
    for name, title, table in (
        ("ablations", "Ablations", Table("bottle", ("variant",), (("default",),))),
        ("motion", "Motion", Table("Motions", ("object", "moves [%]"), (("bottle", 98.0),))),
    ):
        write_report(Report(name, title, "What it is.", (table,), []), tmp_path / name)
    write_document(tmp_path, tmp_path / "benchmarks.md")
    text = (tmp_path / "benchmarks.md").read_text(encoding="utf-8")
    assert re.findall("^## (.*)", text, re.M) == ["Results at a glance", "Motion", "Ablations"]
    assert "98 % with a motion | [Motion](#motion) |" in text


def stored_tables(text):
    """Return the experiments of the page as summaries, read back from it."""
    for section in re.split("^## ", text, flags=re.M)[2:]:
        name = re.search(r"^Command: `regrasp-opt bench ([\w-]+)", section, re.M)[1]
        tables = []
        for part in re.split("^### ", section, flags=re.M)[1:]:
            lines = [line[2:-2].split(" | ") for line in part.splitlines() if line.startswith("| ")]
            rows = [[number(cell) for cell in line] for line in lines[2:]]
            tables.append({"title": part.split("\n")[0], "columns": lines[0], "rows": rows})
        yield {"name": name, "title": section.split("\n")[0], "tables": tables}


def number(cell):
    try:
        return json.loads(cell)
    except ValueError:
        return None if cell == "-" else cell


def test_the_page_of_the_documentation_says_what_its_tables_say():
    text = PAGE.read_text(encoding="utf-8")
    lines = glance(stored_tables(text))
    assert len(lines) == len(HEADLINES)
    first = text.split("\n## ")[1]
    assert first.startswith("Results at a glance")
    assert [tuple(row[2:-2].split(" | ")) for row in first.splitlines() if row.startswith("| ")][2:] == lines
    assert re.findall("^## (.*)", text, re.M)[-1] == "Ablations"
