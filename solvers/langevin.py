"""Langevin dynamics on `J_seq` (Eq. 7, Alg. 1 step 2), in batches.

The noise and the step act on planar parameters scaled to the workspace, so that one unit is half its width, or pi.
With `anneal` the temperature falls to zero along the iterations; each chain returns the best point that it visited.
What is ruled out is asked at the starts, as Ipopt does, and again at the result. torch is
imported when a batch is refined, not before.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from regrasp_opt.connectivity import SequenceObjective
from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.base import Candidates, Refinement, keep_better
from regrasp_opt.solvers.landscape import Landscape, NumPyLandscape, TorchLandscape
from regrasp_opt.threads import one_torch_thread

NUMPY = "numpy"
"""The device without torch."""

_FIXED = 1e-12
"""Half the range of a parameter that is fixed, as in a fixture."""

_CHUNK_ELEMENTS = 1 << 20
"""Hidden units of one layer that a chunk of chains holds at once on a processor: 4 MB, which its cache can hold."""
_GPU_CHUNK_ELEMENTS = 1 << 27
"""The same on a GPU, which wants large batches; with gradients a chunk then takes a few GB."""


@dataclass(frozen=True)
class LangevinRefiner:
    """Langevin dynamics with the paper's constants by default.

    Attributes
    ----------
    iterations : int
        ``K_opt`` (paper: 20).
    eta : float
        Step size (paper: 0.3).
    tau : float
        Temperature (paper: 0.1).
    anneal : bool
        Let the temperature fall linearly to zero; False is the paper's constant temperature.
    keep_best : bool
        Return the best point a chain visited; False returns the last one, as in the paper.
    device : str
        torch device; ``"auto"`` takes a GPU where there is one. ``"numpy"`` does without torch, best for a few chains.
    record : bool
        Keep the poses of every iteration, in `Refinement.paths`.
    """

    iterations: int = 20
    eta: float = 0.3
    tau: float = 0.1
    anneal: bool = False
    keep_best: bool = True
    device: str = "auto"
    record: bool = False

    def __post_init__(self) -> None:
        if self.iterations < 0 or not self.eta > 0 or self.tau < 0:
            raise OptionError("Langevin needs iterations >= 0, eta > 0 and tau >= 0")

    @property
    def name(self) -> str:
        """Short name, for reports."""
        return "langevin"

    def recording(self) -> LangevinRefiner:
        """Return this refiner, but keeping the poses of every iteration."""
        return replace(self, record=True)

    def refine(self, objective: SequenceObjective, starts: Candidates, rng: np.random.Generator) -> Refinement:
        """Return the refined batch; the stats hold the mean cost at every iteration."""
        num_regrasps = starts.xi.shape[1]
        landscape, elements = self._landscape(objective, num_regrasps)
        width = landscape.grasps * objective.energy.model.hidden * max(1, num_regrasps)
        chunk = max(1, elements // width)
        parts, traces, paths = [], [], []
        with nullcontext() if self.device == NUMPY else one_torch_thread():
            for first in range(0, len(starts), chunk):
                xi, trace, path = self._run(landscape, objective, starts.take(slice(first, first + chunk)), rng)
                parts.append(xi)
                traces.append(trace)
                paths += path
        planar, on = objective.placements, starts.placements
        xi = planar.wrapped(on, np.concatenate(parts)) if parts else np.array(starts.xi)
        xi = np.clip(xi, planar.low[on], planar.high[on])  # scaling may leave them by rounding
        if self.keep_best:
            refined = keep_better(objective, starts, xi)
        else:
            refined = Candidates(starts.placements, xi, objective.cost(starts.placements, xi))
        trace = np.concatenate(traces, axis=1) if traces else np.zeros((0, 0))
        return Refinement(
            refined,
            ("finished",) * len(starts),
            tuple(trace.T.astype(np.float64)),
            {"iterations": self.iterations, "evaluations": trace.size, "mean_cost": trace.mean(axis=1).tolist()},
            tuple(paths),
        )

    def _landscape(self, objective: SequenceObjective, num_regrasps: int) -> tuple[Landscape, int]:
        """Return the landscape on the wanted device, and how many hidden units of a layer it should hold at once."""
        if self.device == NUMPY:
            return NumPyLandscape(objective, num_regrasps), _CHUNK_ELEMENTS
        import torch

        name = ("cuda" if torch.cuda.is_available() else "cpu") if self.device == "auto" else self.device
        elements = _CHUNK_ELEMENTS if name == "cpu" else _GPU_CHUNK_ELEMENTS
        return TorchLandscape(objective, num_regrasps, torch.device(name)), elements

    def _run(
        self, landscape: Landscape, objective: SequenceObjective, starts: Candidates, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
        """Return where the chains end (B, N, 3), their costs (K+1, B), and their points (K+1, N, 3) if recorded."""
        low, high = objective.placements.low[starts.placements], objective.placements.high[starts.placements]
        free = ~np.isfinite(high)
        low, high = (np.where(free, side, limit) for side, limit in ((-np.pi, low), (np.pi, high)))
        center, scale = (low + high) / 2, np.maximum((high - low) / 2, _FIXED)
        most = np.where(free, np.inf, 1.0)
        xi, blocked = starts.xi, objective.ruled_out(starts.placements, starts.xi)
        best, best_cost = xi.copy(), np.full(len(xi), np.inf)
        trace, points = [], []
        for k in range(self.iterations + 1):
            cost, gradient = landscape(starts.placements, xi, blocked)
            trace.append(cost)
            if self.record:
                points.append(xi)
            better = cost < best_cost
            best[better], best_cost[better] = xi[better], cost[better]
            if k == self.iterations:
                break
            tau = self.tau * (1 - k / self.iterations) if self.anneal else self.tau
            u = (xi - center) / scale
            u = u - self.eta * gradient * scale + np.sqrt(2 * self.eta * tau) * rng.standard_normal(u.shape)
            u = np.clip(u, -most, most)
            xi = u * scale + center
        found = best if self.keep_best else xi
        return found, np.array(trace), list(np.stack(points, axis=1)) if points else []
