"""What an experiment hands back, and the files made from it: rows, a JSON summary, an HTML page, Markdown tables."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from regrasp_opt.benchmarks.harness.environment import environment
from regrasp_opt.benchmarks.harness.runner import Row, write_csv
from regrasp_opt.files import atomic_path

Cell = str | float | int | None
FORMAT = 1


@dataclass(frozen=True)
class Table:
    """A table of figures; ``note`` says what they are."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Figure:
    """A plotly figure with its caption."""

    caption: str
    figure: Any


@dataclass(frozen=True)
class Report:
    """The outcome of one experiment.

    Attributes
    ----------
    name, title : str
        Name on the command line, and heading.
    text : str
        What was measured, and how.
    tables, figures
    rows : list of Row
        Everything measured.
    instances : dict
        Hash of the start-goal pairs, by object.
    revisions : tuple of str
        Git revisions of the code that made the rows.
    settings : dict
        Sizes and seeds.
    conclusion : str
        What the tables say, in paragraphs with an empty line between them.
    command : str
        The command that makes it, where that is not `regrasp-opt bench`.
    """

    name: str
    title: str
    text: str
    tables: tuple[Table, ...]
    rows: list[Row]
    figures: tuple[Figure, ...] = ()
    instances: dict[str, str] = field(default_factory=dict)
    revisions: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    conclusion: str = ""
    command: str = ""

    @property
    def errors(self) -> list[Row]:
        """Rows that hold an error instead of a measurement."""
        return [row for row in self.rows if row.get("error")]


def write_report(report: Report, folder: Path) -> dict[str, Any]:
    """Write ``rows.csv``, ``summary.json`` and ``index.html`` of `report` to `folder`; return the summary."""
    summary = {
        "format": FORMAT,
        "name": report.name,
        "title": report.title,
        "text": report.text,
        "settings": report.settings,
        "made": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "environment": environment(),
        "revisions": list(report.revisions),
        "instances": report.instances,
        "rows": len(report.rows),
        "errors": [{key: row[key] for key in row if row[key] is not None} for row in report.errors],
        "tables": [asdict(table) for table in report.tables],
        "conclusion": report.conclusion,
        "command": report.command or f"regrasp-opt bench {report.name}",
    }
    write_csv(report.rows, folder / "rows.csv")
    with atomic_path(folder / "index.html") as temporary:
        temporary.write_text(_page(summary, report.figures), encoding="utf-8")
    with atomic_path(folder / "summary.json") as temporary:
        temporary.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return summary


def write_document(folder: Path, path: Path) -> None:
    """Write the tables of all experiments whose results are in `folder` to the Markdown file `path`."""
    parts = [
        "# Benchmarks",
        "",
        "This file is written by `regrasp-opt bench`; every figure in it was measured by that command, but for the "
        "paper's, which are printed in it. Those stand beside ours for the paper's own meshes alone (`bunny.stl`, "
        "`mug.stl`, `pentagon.stl`, evaluated with `--objects FOLDER`): the built-in objects are others. Grasps, robot "
        "model and checker differ from the paper's there too.",
        "",
    ]
    for summary in _summaries(folder):
        parts += _section(summary, 2)
    _write_lines(parts, path)


def write_page(summary: dict[str, Any], path: Path) -> None:
    """Write the tables of one experiment, whose `summary` `write_report` returned, to the Markdown file `path`."""
    lines = _section(summary, 1)
    said = f"This page is written by `{_command(summary)}`."
    _write_lines([*lines[:2], said, "", *lines[2:]], path)


def _section(summary: dict[str, Any], level: int) -> list[str]:
    heading = "#" * level
    parts = [f"{heading} {summary['title']}", "", summary["text"], "", _provenance(summary), ""]
    for table in summary["tables"]:
        parts += [f"{heading}# {table['title']}", "", *markdown(table["columns"], table["rows"]), ""]
        parts += [table["note"], ""] if table["note"] else []
    parts += [summary["conclusion"], ""] if summary.get("conclusion") else []
    for error in summary["errors"]:
        parts += [f"* `{error.get('object', '')}`: {error['error']}", ""]
    return parts


def _write_lines(lines: list[str], path: Path) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def _summaries(folder: Path) -> list[dict[str, Any]]:
    found = []
    for path in sorted(folder.glob("*/summary.json")):
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.get("format") == FORMAT and "tables" in content:
            found.append(content)
    return found


def _command(summary: dict[str, Any]) -> str:
    return str(summary.get("command") or f"regrasp-opt bench {summary['name']}")


def _provenance(summary: dict[str, Any]) -> str:
    machine = summary["environment"]["machine"]
    settings = ", ".join(f"{key} {value}" for key, value in summary["settings"].items())
    revisions = ", ".join(summary["revisions"]) or "unknown"
    command = _command(summary) + (" --quick" if summary["settings"].get("quick") else "")
    return (
        f"Command: `{command}`. Settings: {settings}. Code: {revisions}. Machine: {machine['processor']}, "
        f"{machine['cores']} cores, accelerator: {machine['accelerator']}. Made {summary['made']}."
    )


def markdown(header: Iterable[str], rows: Iterable[Iterable[Cell]]) -> list[str]:
    """Return the lines of a Markdown table."""
    head = list(header)
    cells = [head, ["---"] * len(head), *([shown(cell) for cell in row] for row in rows)]
    return ["| " + " | ".join(line) + " |" for line in cells]


_STYLE = """body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1100px;padding:0 1rem;color:#1f2328}
table{border-collapse:collapse;margin:.6rem 0}th,td{border:1px solid #d0d7de;padding:.25rem .6rem;text-align:right}
th{background:#f6f8fa}td:first-child,th:first-child{text-align:left}.note{color:#57606a;max-width:80ch}"""


def _page(summary: dict[str, Any], figures: Sequence[Figure]) -> str:
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{html.escape(summary['title'])}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(summary['title'])}</h1>",
        *(f"<p>{html.escape(text)}</p>" for text in summary["text"].split("\n\n")),
        f"<p class='note'>{html.escape(_provenance(summary))}</p>",
    ]
    for table in summary["tables"]:
        head = "".join(f"<th>{html.escape(name)}</th>" for name in table["columns"])
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(shown(cell))}</td>" for cell in row) + "</tr>" for row in table["rows"]
        )
        parts.append(f"<h2>{html.escape(table['title'])}</h2><table><tr>{head}</tr>{body}</table>")
        parts.append(f"<p class='note'>{html.escape(table['note'])}</p>" if table["note"] else "")
    parts += [f"<p>{html.escape(text)}</p>" for text in summary["conclusion"].split("\n\n") if text]
    if summary["errors"]:
        lines = "".join(
            f"<li>{html.escape(str(row.get('object', '')))}: {html.escape(str(row['error']))}</li>"
            for row in summary["errors"]
        )
        parts.append(f"<h2>Not measured</h2><ul>{lines}</ul>")
    for number, item in enumerate(figures):
        plot = item.figure.to_html(full_html=False, include_plotlyjs=number == 0)
        parts.append(f"<h2>{html.escape(item.caption)}</h2>{plot}")
    return "\n".join([*parts, "</body></html>"])


def shown(cell: Cell) -> str:
    """Return `cell` as a reader sees it."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    return f"{cell:g}" if isinstance(cell, float) else str(cell)


def percent(hits: Sequence[Any]) -> float | None:
    """Return the mean of truth values or shares in percent to one decimal; None of nothing."""
    return round(100 * sum(float(h) for h in hits) / len(hits), 1) if hits else None


def mean(values: Sequence[float], digits: int = 2) -> float | None:
    """Return the rounded mean; None of nothing."""
    return round(sum(values) / len(values), digits) if values else None
