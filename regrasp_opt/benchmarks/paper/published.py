"""The paper's figures, as printed in its Tables I to III, in percent unless stated. They stand beside ours, as data.

The paper's objects are a bottle, a mug, a bunny and a pentagon. Its figures stand beside ours for its own meshes only,
which it publishes for the last three; the built-in objects are others, and their rows stand alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

PAPER_OBJECT = {"mug.stl": "mug", "pentagon.stl": "pentagon", "bunny.stl": "bunny"}
"""The paper's object that each mesh file is."""

END_EFFECTORS = ("w", "r140", "r85", "s1", "s2", "s3")
"""Rows of Table II; its columns are the same in the order S1, S2, S3, W, R1, R2."""


Printed = TypeVar("Printed")


def _rows(kind: Callable[..., Printed], keys: Iterable[Any], printed: dict[str, str]) -> dict[str, dict[Any, Printed]]:
    """Return by object, then by key, the rows that stand in the texts `printed`, with a comma between them."""
    return {
        name: {key: kind(*map(float, row.split())) for key, row in zip(keys, text.split(","), strict=True)}
        for name, text in printed.items()
    }


class OneStep(NamedTuple):
    """A row of Table I: S.V. of the three costs and of unseen grasps."""

    J: float
    J_plus: float
    J_h: float
    unseen: float


ONE_STEP: dict[str, dict[int, OneStep]] = _rows(
    OneStep,
    (200, 100, 50, 10),
    {
        "bottle": "83.1 73.0 57.1 72.9, 85.9 75.3 58.0 72.8, 85.4 76.6 57.6 72.2, 82.0 77.0 60.0 76.0",
        "mug": "70.8 24.9 29.9 16.1, 83.7 37.6 53.0 28.6, 82.4 45.2 61.4 34.8, 76.0 43.0 42.0 29.0",
        "bunny": "56.0 53.0 37.2 45.8, 55.3 54.6 38.3 49.8, 53.2 55.6 37.2 51.6, 48.0 57.0 32.0 59.0",
        "pentagon": "67.0 56.5 65.4 41.4, 63.6 56.0 62.5 46.0, 63.2 55.8 62.2 45.6, 60.0 51.0 61.0 45.0",
    },
)
"""Table I, by K_top."""


def _by_tool(*row: float) -> dict[str, float]:
    return dict(zip(("s1", "s2", "s3", "w", "r140", "r85"), row, strict=True))


CROSS_EFFECTOR: dict[str, dict[str, dict[str, float]]] = _rows(
    _by_tool,
    END_EFFECTORS,
    {
        "bottle": "0.0 0.0 0.0 86.3 67.2 63.9, 0.0 0.0 0.0 33.0 41.5 33.9, 0.9 0.2 3.0 62.5 67.6 64.6, "
        "51.2 34.0 30.3 35.5 40.4 44.8, 44.7 40.0 36.0 42.8 33.3 49.0, 34.2 20.1 55.5 21.3 25.6 27.2",
        "bunny": "9.2 0.0 0.0 66.8 32.5 26.7, 0.0 1.7 0.0 10.8 35.4 0.0, 5.5 22.9 0.0 8.1 33.7 39.9, "
        "39.7 29.5 1.4 25.5 4.6 0.0, 4.5 46.1 0.6 26.2 0.1 0.0, 0.0 0.0 5.9 0.0 0.0 0.0",
        "mug": "0.0 11.7 11.4 75.7 55.7 19.7, 0.8 7.3 5.5 51.6 54.3 15.9, 1.5 21.0 19.5 28.9 19.6 71.8, "
        "33.6 16.6 17.9 5.7 4.9 2.6, 12.3 62.5 36.9 0.0 0.0 6.9, 0.0 0.0 20.3 0.0 0.0 0.0",
        "pentagon": "17.2 9.4 9.7 64.2 53.9 47.7, 24.6 15.6 17.0 17.2 44.4 53.5, 18.8 8.0 16.0 16.0 32.5 58.1, "
        "40.2 41.3 46.4 25.8 17.7 27.3, 57.5 57.4 54.6 41.1 27.2 41.5, 62.8 69.2 88.1 49.4 40.8 54.5",
    },
)
"""Table II: S.V. at K_top = 100, by object, trained end-effector and tested end-effector."""


class MultiStep(NamedTuple):
    """A row of Table III: threshold and hard success [%], mean length and mean time [s]."""

    threshold: float
    hard: float
    length: float
    seconds: float


MULTI_STEP: dict[str, dict[int, MultiStep]] = _rows(
    MultiStep,
    (10, 50),
    {
        "bottle": "42.0 48.0 1.67 1.67, 44.0 50.0 1.82 1.97",
        "mug": "10.0 10.0 1.0 0.55, 10.0 10.0 1.0 0.55",
        "bunny": "94.0 94.0 1.09 0.68, 94.0 96.0 1.09 0.68",
        "pentagon": "90.0 84.0 1.09 0.66, 92.0 84.0 1.17 0.83",
    },
)
"""Table III, by K_top."""
