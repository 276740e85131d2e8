"""The `Refiner` protocol and what goes in and comes out: batches of candidate sequences.

A refiner knows poses, energies and costs only. To add one, write a class with a `name` and a `refine` method; nothing
needs to be registered (docs/adding-a-refiner.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from regrasp_opt.connectivity import SequenceObjective
from regrasp_opt.conventions import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Candidates:
    """A batch of B sequences of N intermediate poses.

    ``placements`` (B, N) numbers into the objective's placements, ``xi`` (B, N, 3) planar parameters [m, m, rad],
    ``cost`` (B,) the objective's value.
    """

    placements: IntArray
    xi: FloatArray
    cost: FloatArray

    def __len__(self) -> int:
        return len(self.cost)

    def take(self, indices: Any) -> Candidates:
        """Return the candidates at `indices`."""
        return Candidates(self.placements[indices], self.xi[indices], self.cost[indices])

    def best(self, count: int) -> Candidates:
        """Return the `count` cheapest, the cheapest first; ties keep their order."""
        return self.take(np.argsort(self.cost, kind="stable")[:count])


@dataclass(frozen=True)
class Refinement:
    """The refined batch, in the order of the starts, and what it took.

    Attributes
    ----------
    candidates : Candidates
    status : tuple of str
        How each candidate's refinement ended, in the refiner's own words.
    traces : tuple of arrays
        Cost of each candidate by iteration, the start first.
    stats : dict
        Plain numbers, JSON-serialisable; the keys are the refiner's own.
    paths : tuple of arrays
        Planar parameters (k, N, 3) of each candidate by iteration, the start first; empty unless the refiner was asked
        to keep them (`RecordingRefiner`).
    """

    candidates: Candidates
    status: tuple[str, ...]
    traces: tuple[FloatArray, ...]
    stats: dict[str, Any] = field(default_factory=dict)
    paths: tuple[FloatArray, ...] = ()


class Refiner(Protocol):
    """Anything that improves a batch of candidate sequences."""

    @property
    def name(self) -> str:
        """Short name, for reports."""

    def refine(self, objective: SequenceObjective, starts: Candidates, rng: np.random.Generator) -> Refinement:
        """Return the batch improved: as many candidates as `starts`, none with a higher cost than its start.

        Parameters
        ----------
        objective : SequenceObjective
            What is minimised.
        starts : Candidates
            B sequences of N intermediate poses.
        rng : Generator
            The only source of randomness.
        """
        ...


def keep_better(objective: SequenceObjective, starts: Candidates, xi: FloatArray) -> Candidates:
    """Return `xi` (B, N, 3) as candidates, with the start instead wherever that costs less."""
    cost = objective.cost(starts.placements, xi)
    worse = cost > starts.cost
    return Candidates(
        starts.placements, np.where(worse[:, None, None], starts.xi, xi), np.where(worse, starts.cost, cost)
    )


def random_starts(objective: SequenceObjective, num_regrasps: int, count: int, rng: np.random.Generator) -> Candidates:
    """Return `count` sequences of random placements at uniform planar parameters (Alg. 1, line 2)."""
    choices = np.arange(len(objective.placements)) if objective.choices is None else objective.choices
    placements = choices[rng.integers(len(choices), size=(count, num_regrasps))]
    share = np.concatenate([rng.random((count, num_regrasps, k)) for k in (2, 1)], axis=2)
    xi = objective.placements.inside(placements, share)
    return Candidates(placements, xi, objective.cost(placements, xi, np.float32).astype(np.float64))


def wrap_yaw(xi: FloatArray) -> FloatArray:
    """Return `xi` (..., 3) with the yaw in [0, 2 pi)."""
    out = np.array(xi)
    out[..., 2] %= 2 * np.pi
    return out
