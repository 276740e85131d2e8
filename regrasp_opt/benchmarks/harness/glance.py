"""The results at a glance: for each experiment a line of figures, taken from its stored tables.

A line takes columns of one table. A figure is the value in the rows that are meant, or the least and the greatest.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, NamedTuple

ORDER = (
    "any",
    "refiners",
    "multi-step",
    "hard-tiers",
    "one-step",
    "unseen",
    "motion",
    "joint",
    "cross-effector",
    "cost-sweep",
)
"""Experiments in the order of the document; others follow, and ablations come last."""


class Headline(NamedTuple):
    """What a line says, the table that it takes figures from, and the columns with the words for their figures.

    `where` is a column and the value that rows must have in it, all rows without it.
    """

    experiment: str
    says: str
    table: str
    columns: dict[str, str]
    where: tuple[str, str | int] | None = None


PLANNERS = {
    "pairs": "{} pairs",
    "solved [%]": "{} % solved",
    "median [s]": "half within {} s",
    "90 % [s]": "90 % within {} s",
    "before [s]": "after {} s of preparation, once",
}
POSES = {
    "ours J": "ours {} %",
    "Langevin J": "our energy with the paper's optimiser {} %",
    "paper's preset J": "the paper's method trained here {} %",
}
TIMES = {"planned": "{} planned", "median [s]": "half within {} s", "p95 [s]": "95 % within {} s"}
FOUND = {"pairs": "{} pairs", "solved [%]": "{} % solved", "N no larger [%]": "{} % with no more regrasps"}
HEADLINES = (
    *(
        Headline("any", says, "Time to a verified plan", TIMES, ("what", row))
        for row, says in (
            ("mesh file to plan, warm process", "From a mesh file to a verified plan, nothing prepared"),
            ("mesh file to plan, whole process", "The same as a process of its own, with an empty data folder"),
            ("obstacles put in to plan", "From obstacles that were moved to a verified plan"),
        )
    ),
    *(
        Headline("any", says, "Success by planner", FOUND, ("planner", planner))
        for planner, says in (
            ("arm energy", "Pairs of built-in objects, of these meshes, and between obstacles, by an exact search"),
            ("constant energy", "The same with an energy that knows nothing, as a control"),
        )
    ),
    Headline(
        "refiners",
        "Plans of the default planner, for pairs that the exact search solves",
        "Success and time to the first verified plan",
        PLANNERS,
        ("planner", "ipopt from lattice"),
    ),
    Headline(
        "refiners",
        "Plans of the exact regrasp graph, for the same pairs",
        "Success and time to the first verified plan",
        PLANNERS,
        ("planner", "regrasp graph"),
    ),
    Headline(
        "multi-step",
        "Random pairs without a shared grasp that the exact search solves, by object",
        "Against the exact oracle",
        {"pairs": "{} pairs", "S.H. of these [%]": "{} % solved", "N no more [%]": "{} % with no more regrasps"},
    ),
    *(
        Headline(
            "hard-tiers",
            f"Few grasps, obstacles, a narrow workspace: tasks of {words}, by object",
            "Success by the oracle's fewest regrasps",
            {"solved [%]": "{} % solved", "solved [s]": "{} s in the mean"},
            ("oracle N", number),
        )
        for number, words in ((2, "two regrasps"), ("3+", "three regrasps or more"))
    ),
    Headline(
        "one-step",
        "Valid ones among the ten cheapest intermediate poses, by object",
        "S.V. by cost and generator [%]",
        POSES | {"paper J": "printed in the paper {} %"},
        ("K_top", 10),
    ),
    Headline(
        "unseen",
        "The same with grasps that training has not seen",
        "S.V. on unseen grasps [%]",
        POSES | {"paper Usn": "printed in the paper {} %"},
        ("K_top", 10),
    ),
    Headline(
        "motion",
        "Joint motions for pairs that need a regrasp, by object",
        "Motions",
        {"pairs": "{} pairs", "moves [%]": "{} % with a motion", "both [s]": "half of plans with motions within {} s"},
    ),
    Headline(
        "joint",
        "Joint travel of a plan, lowered at the same number of regrasps",
        "The travel, lowered at equal N",
        {"pairs": "{} pairs", "in all [%]": "lowered by {} % in the median", "verified [%]": "{} % verified"},
        ("object", "all"),
    ),
)


def in_order(summaries: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the summaries of experiments as the document has them: results first, ablations last."""

    def place(summary: dict[str, Any]) -> tuple[bool, int, str]:
        name = summary["name"]
        return name == "ablations", ORDER.index(name) if name in ORDER else len(ORDER), name

    return sorted(summaries, key=place)


def glance(summaries: Iterable[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Return what is said, the figures and a link to the section, for each headline whose table is there."""
    known = {summary["name"]: summary for summary in summaries}
    lines = []
    for headline in HEADLINES:
        summary = known.get(headline.experiment, {"title": "", "tables": []})
        tables = [table for table in summary["tables"] if table["title"] == headline.table]
        rows = [dict(zip(table["columns"], cells, strict=True)) for table in tables for cells in table["rows"]]
        if headline.where is not None:
            column, value = headline.where
            rows = [row for row in rows if row.get(column) == value]
        shown = ((words, [row.get(name) for row in rows]) for name, words in headline.columns.items())
        figures = [text for words, values in shown if (text := _figure(words, values))]
        if figures:
            title = summary["title"]
            anchor = re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
            lines.append((headline.says, "; ".join(figures), f"[{title}](#{anchor})"))
    return lines


def _figure(words: str, values: list[Any]) -> str:
    numbers = [value for value in values if isinstance(value, int | float) and value == value]
    if not numbers:
        return ""
    low, high = min(numbers), max(numbers)
    return words.format(f"{low:g}" if low == high else f"{low:g} to {high:g}")
