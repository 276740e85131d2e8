"""Tables and curves made of an experiment's rows: each column is a function of the rows of one line."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from regrasp_opt.benchmarks.harness.report import Cell, Table, mean, percent
from regrasp_opt.benchmarks.harness.runner import Row

Column = Callable[[list[Row]], Cell]
Value = str | Callable[[Row], Any]
"""The name of a column of the rows, or a function of a row."""


def grouped(rows: Iterable[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Return the rows that have all of the columns `keys`, by the values of these, in order of their appearance."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if all(key in row for key in keys):
            groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def values(rows: Iterable[Row], value: Value, of: Value | None = None) -> list[Any]:
    """Return a value of each of the rows that have it and, with `of`, for which that is true."""
    wanted = rows if of is None else [row for row in rows if _read(row, of)]
    return [found for row in wanted if (found := _read(row, value)) is not None]


def _read(row: Row, value: Value) -> Any:
    return row.get(value) if isinstance(value, str) else value(row)


def count(of: Value) -> Column:
    """Return the column of the number of rows for which `of` is true."""
    return lambda rows: sum(bool(_read(row, of)) for row in rows)


def share(value: Value, of: Value | None = None) -> Column:
    """Return the column of the mean [%] of truth values or shares."""
    return lambda rows: percent(values(rows, value, of))


def average(value: Value, digits: int = 2, of: Value | None = None) -> Column:
    """Return the column of a rounded mean."""
    return lambda rows: mean(values(rows, value, of), digits)


def quantile(value: Value, share: float, digits: int = 3, of: Value | None = None) -> Column:
    """Return the column of the rounded value that a `share` of the rows do not exceed."""

    def column(rows: list[Row]) -> Cell:
        found = values(rows, value, of)
        return round(float(np.quantile(found, share)), digits) if found else None

    return column


def middle(value: Value, digits: int = 3, of: Value | None = None) -> Column:
    """Return the column of a rounded median."""
    return quantile(value, 0.5, digits, of)


def late(value: Value, digits: int = 3, of: Value | None = None) -> Column:
    """Return the column of a rounded 95th percentile."""
    return quantile(value, 0.95, digits, of)


def largest(value: Value, digits: int = 3) -> Column:
    """Return the column of the largest value, rounded."""
    return quantile(value, 1.0, digits)


def summary(
    title: str, keys: Sequence[str], groups: Mapping[Any, list[Row]], columns: Mapping[str, Column], note: str = ""
) -> Table:
    """Return a table with a line for each of `groups`: its key, or tuple of keys, then `columns` of its rows."""
    lines = [
        (*(key if isinstance(key, tuple) else (key,)), *(column(rows) for column in columns.values()))
        for key, rows in groups.items()
    ]
    return Table(title, (*keys, *columns), tuple(lines), note)


def listing(title: str, rows: Sequence[Row], columns: Mapping[str, Value], note: str = "") -> Table:
    """Return a table with a line for each row; where there is none, the note says so."""
    lines = tuple(tuple(_read(row, value) for value in columns.values()) for row in rows)
    return Table(title, tuple(columns), lines, note if lines else "There are none.")


def by_object(rows: Sequence[Row], names: Iterable[str], every: str | None = None) -> dict[Hashable, list[Row]]:
    """Return the rows of each object, and under the name `every`, if it is given, those of all."""
    groups: dict[Hashable, list[Row]] = {name: [row for row in rows if row.get("object") == name] for name in names}
    return groups | ({} if every is None else {every: [row for row in rows if row.get("object") in groups]})


def time_curves(groups: Mapping[Any, list[Row]], seconds: str, done: str, title: str, height: int = 380) -> go.Figure:
    """Return, for each group, the share of its rows that are `done` within a time, which their column `seconds` has."""
    figure = go.Figure()
    for name, rows in groups.items():
        times = sorted(row[seconds] for row in rows if row[done])
        shares = [100 * (i + 1) / len(rows) for i in range(len(times))]
        figure.add_trace(go.Scatter(x=times, y=shares, mode="lines", line={"shape": "hv"}, name=name))
    figure.update_xaxes(type="log")
    figure.update_yaxes(range=[0, 101])
    return labelled(figure, "seconds", title, height)


def labelled(figure: go.Figure, x: str, y: str, height: int) -> go.Figure:
    """Return `figure` with titles of its axes and a height [px]."""
    figure.update_xaxes(title_text=x)
    figure.update_yaxes(title_text=y)
    return figure.update_layout(height=height, margin={"l": 60, "r": 10, "t": 40, "b": 50})
