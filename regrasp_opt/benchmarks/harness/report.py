"""What an experiment hands back, and the files made from it: rows, a JSON summary, a page in Markdown and HTML."""

from __future__ import annotations

import html
import json
import math
import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

from regrasp_opt.benchmarks.harness.glance import glance, in_order
from regrasp_opt.benchmarks.harness.runner import Row, git_revision, write_csv
from regrasp_opt.files import atomic_path

Cell = str | float | int | None
FORMAT = 1
PACKAGES = ("regrasp-opt", "numpy", "scipy", "torch", "casadi", "pin", "coal", "eaik", "trimesh", "joblib", "plotly")
"""Those whose versions a report tells."""


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
    """The outcome of one experiment: its name on the command line, a heading, what was measured, and all rows of it.

    `instances` has the hash of the start-goal pairs of each object, `revisions` the git revisions of the code that made
    the rows, `settings` sizes and seeds; `command` is what makes it, where that is not `regrasp-opt bench`.
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
    command: str = ""

    @property
    def errors(self) -> list[Row]:
        """Rows that hold an error instead of a measurement."""
        return [row for row in self.rows if row.get("error")]


def write_report(report: Report, folder: Path) -> dict[str, Any]:
    """Write ``rows.csv``, ``summary.json``, ``NAME.md`` and ``index.html`` to `folder`; return the summary.

    Both pages say the same; the second shows the figures too.
    """
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
        "command": report.command or f"regrasp-opt bench {report.name}",
    }
    heading, *rest = _section(summary, 1)
    text = "\n".join([heading, "", f"This page is written by `{summary['command']}`.", *rest])
    write_csv(report.rows, folder / "rows.csv")
    _write(folder / f"{report.name}.md", text)
    _write(folder / "index.html", _page(report.title, text, report.figures))
    _write(folder / "summary.json", json.dumps(summary, indent=1))
    return summary


def environment() -> dict[str, Any]:
    """Return what a figure is measured on, JSON-serialisable: versions and the machine."""
    import torch

    versions = {"python": platform.python_version()} | {name: _version(name) for name in PACKAGES}
    machine = {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "accelerator": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
    }
    return {"versions": versions, "machine": machine, "revision": git_revision()}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())


def write_document(folder: Path, path: Path) -> None:
    """Write the tables of all experiments whose results are in `folder` to `path` (Markdown), results first."""
    stored = [json.loads(each.read_text(encoding="utf-8")) for each in sorted(folder.glob("*/summary.json"))]
    summaries = in_order(summary for summary in stored if summary.get("format") == FORMAT)
    parts = [
        "# Benchmarks",
        "",
        "This file is written by `regrasp-opt bench`; every figure in it was measured by that command, but for the "
        "paper's, which are printed in it. Those stand beside ours for the paper's own meshes alone (`bunny.stl`, "
        "`mug.stl`, `pentagon.stl`, evaluated with `--objects FOLDER`): the built-in objects are others. Grasps, robot "
        "model and checker differ from the paper's there too.",
        "",
    ]
    lines = glance(summaries)
    if lines:
        parts += ["## Results at a glance", "", *markdown(("what", "measured", "section"), lines), ""]
        parts += ["Figures of several rows are the least and the greatest; the sections say what they mean.", ""]
    for summary in summaries:
        parts += _section(summary, 2)
    _write(path, "\n".join(parts))


def _section(summary: dict[str, Any], level: int) -> list[str]:
    heading = "#" * level
    parts = [f"{heading} {summary['title']}", "", summary["text"], "", _provenance(summary), ""]
    for table in summary["tables"]:
        parts += [f"{heading}# {table['title']}", "", *markdown(table["columns"], table["rows"]), ""]
        parts += [table["note"], ""] if table["note"] else []
    for error in summary["errors"]:
        parts += [f"* `{error.get('object', '')}`: {error['error']}", ""]
    return parts


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text.rstrip() + "\n", encoding="utf-8")


def _provenance(summary: dict[str, Any]) -> str:
    machine = summary["environment"]["machine"]
    settings = ", ".join(f"{key} {value}" for key, value in summary["settings"].items())
    revisions = ", ".join(summary["revisions"]) or "unknown"
    command = summary["command"] + (" --quick" if summary["settings"].get("quick") else "")
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
th{background:#f6f8fa}td:first-child,th:first-child{text-align:left}p{max-width:80ch}"""


def _page(title: str, text: str, figures: Sequence[Figure]) -> str:
    """Return the Markdown `text` and the figures as one HTML page that loads nothing."""
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    head = f"<meta charset='utf-8'><title>{html.escape(title)}</title><style>{_STYLE}</style>"
    parts = [f"<!doctype html><html lang='en'><head>{head}</head><body>{body}"]
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
