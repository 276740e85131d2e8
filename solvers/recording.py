"""Keep what a refiner does with its batches, for pictures and plots of how it converges.

`RecordingRefiner` stands between a search and the refiner of its recipe; neither knows of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.connectivity import SequenceObjective
from regrasp_opt.solvers.base import Candidates, Refinement, Refiner


class RecordedBatch(NamedTuple):
    """One call of a refiner."""

    objective: SequenceObjective
    starts: Candidates
    refinement: Refinement


class RecordingRefiner:
    """Pass every batch on to `refiner` and keep it, with what came back.

    Parameters
    ----------
    refiner : Refiner
        If it has a method ``recording``, what that returns is used: the same refiner, keeping `Refinement.paths`.
    paths : bool
        Whether to ask for that; otherwise the refiner is used as it is.

    Attributes
    ----------
    batches : list of RecordedBatch
    """

    def __init__(self, refiner: Refiner, *, paths: bool = True) -> None:
        recording = getattr(refiner, "recording", None) if paths else None
        self._refiner: Refiner = refiner if recording is None else recording()
        self.batches: list[RecordedBatch] = []

    @property
    def name(self) -> str:
        """Short name, for reports."""
        return self._refiner.name

    def refine(self, objective: SequenceObjective, starts: Candidates, rng: np.random.Generator) -> Refinement:
        """Return what the refiner makes of `starts`."""
        refinement = self._refiner.refine(objective, starts, rng)
        self.batches.append(RecordedBatch(objective, starts, refinement))
        return refinement
