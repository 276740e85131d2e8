"""The paper's figures, as printed in its Tables I to III, in percent unless stated. They stand beside ours, as data.

The paper's objects are a bottle, a mug, a bunny and a pentagon. Its figures stand beside ours for its own meshes only,
which it publishes for the last three; the built-in objects are others, and their rows stand alone.
"""

from __future__ import annotations

import json
from importlib.resources import files

PAPER_OBJECT = {"mug.stl": "mug", "pentagon.stl": "pentagon", "bunny.stl": "bunny"}
"""The paper's object that each mesh file is."""

END_EFFECTORS = ("w", "r140", "r85", "s1", "s2", "s3")
"""Rows of Table II."""

Rows = list[list[float]]
_PRINTED: dict[str, dict[str, Rows]] = json.loads(
    (files("regrasp_opt") / "data" / "published.json").read_text(encoding="utf-8")
)


def _by_k_top(table: str, k_top: tuple[int, ...]) -> dict[str, dict[int, tuple[float, ...]]]:
    return {name: dict(zip(k_top, map(tuple, rows), strict=True)) for name, rows in _PRINTED[table].items()}


def _by_tools(rows: Rows) -> dict[str, dict[str, float]]:
    tested = ("s1", "s2", "s3", "w", "r140", "r85")
    return {trained: dict(zip(tested, row, strict=True)) for trained, row in zip(END_EFFECTORS, rows, strict=True)}


ONE_STEP = _by_k_top("one_step", (200, 100, 50, 10))
"""Table I, by object and K_top: S.V. of the costs J, J+ and J^h, and of unseen grasps."""

CROSS_EFFECTOR = {name: _by_tools(rows) for name, rows in _PRINTED["cross_effector"].items()}
"""Table II: S.V. at K_top = 100, by object, trained end-effector and tested end-effector."""

MULTI_STEP = _by_k_top("multi_step", (10, 50))
"""Table III, by object and K_top: threshold and hard success [%], mean length and mean time [s]."""
