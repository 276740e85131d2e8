"""Langevin dynamics on `J_seq` (Eq. 7, Alg. 1 step 2), batched in torch.

The noise and the step act on planar parameters scaled to the workspace, so that one unit is half its width, or pi.
With `anneal` the temperature falls to zero along the iterations; each chain returns the best point that it visited.
torch is imported when a batch is refined, not before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from regrasp_opt.connectivity import BLOCKED, SequenceObjective, sequence_cost
from regrasp_opt.energy.activations import TorchNetwork
from regrasp_opt.energy.network import evaluate
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.base import Candidates, Refinement, keep_better, wrap_yaw
from regrasp_opt.threads import one_torch_thread

if TYPE_CHECKING:
    import torch

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
        torch device; ``"auto"`` takes a GPU where there is one.
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
        import torch

        name = ("cuda" if torch.cuda.is_available() else "cpu") if self.device == "auto" else self.device
        num_regrasps = starts.xi.shape[1]
        landscape = _Landscape(objective, num_regrasps, torch.device(name))
        width = landscape.grasps * objective.energy.model.hidden * max(1, num_regrasps)
        chunk = max(1, (_CHUNK_ELEMENTS if name == "cpu" else _GPU_CHUNK_ELEMENTS) // width)
        noise = torch.Generator().manual_seed(int(rng.integers(2**63 - 1)))
        parts, traces, paths = [], [], []
        with one_torch_thread():
            for first in range(0, len(starts), chunk):
                xi, trace, path = self._run(landscape, starts.take(slice(first, first + chunk)), noise)
                parts.append(xi)
                traces.append(trace)
                paths += path
        xi = wrap_yaw(np.concatenate(parts)) if parts else np.array(starts.xi)
        xi[..., :2] = np.clip(xi[..., :2], *objective.bounds)  # single precision may leave them by rounding
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

    def _run(self, landscape: _Landscape, starts: Candidates, noise: torch.Generator) -> tuple[Any, Any, Any]:
        import torch

        u = landscape.scaled(starts.xi)
        placements = torch.as_tensor(starts.placements)
        best, best_cost = u.clone(), torch.full((len(u),), torch.inf, device=u.device)
        trace, points = [], []
        for k in range(self.iterations + 1):
            u.requires_grad_(True)
            cost = landscape.cost(placements, u)
            (gradient,) = torch.autograd.grad(cost.sum(), u)
            u, cost = u.detach(), cost.detach()
            trace.append(cost.cpu().numpy())
            if self.record:
                points.append(landscape.unscaled(u))
            better = cost < best_cost
            best[better], best_cost[better] = u[better], cost[better]
            if k == self.iterations:
                break
            tau = self.tau * (1 - k / self.iterations) if self.anneal else self.tau
            z = torch.randn(u.shape, generator=noise).to(u.device)
            u = landscape.clamp(u - self.eta * gradient + (2 * self.eta * tau) ** 0.5 * z)
        found = landscape.unscaled(best if self.keep_best else u)
        return found, np.array(trace), list(np.stack(points, axis=1)) if points else []


class _Landscape:
    """The objective in torch, single precision, over scaled planar parameters and the grasps that can matter.

    The first layer is affine in (1, cos, sin) of the yaw at each placement and in x and y, so the pre-activations of a
    pose for all grasps are one row of a matrix product: the numbers above, put in the columns of the pose's placement,
    times a table.
    """

    def __init__(self, objective: SequenceObjective, num_regrasps: int, device: torch.device) -> None:
        import torch

        def tensor(array: Any) -> torch.Tensor:
            return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=device)

        energy, model = objective.energy, objective.energy.model
        ids = objective.useful_grasps(num_regrasps)
        low, high = objective.bounds
        self.grasps = len(ids)
        self.options = objective.options
        self.model, self.network = model, TorchNetwork()
        self.center = tensor([*(low + high) / 2, 0.0])
        self.scale = tensor([*(high - low) / 2, np.pi])
        self.rule, self.ids = objective.rule, ids
        self.ends = tensor(np.stack([objective.start_energy[ids], objective.goal_energy[ids]]))
        planar = [energy.planar_layer(T_p, ids) for T_p in objective.placements]
        rows = [part for layer in planar for part in (layer.constant, layer.cosine, layer.sine)]
        rows += [np.broadcast_to(shift, rows[0].shape) for shift in (planar[0].dx, planar[0].dy)]
        self.first = tensor(np.stack([row.T.ravel() for row in rows]))  # (3 S + 2, A H)
        self.of_placement = torch.eye(len(planar), device=device)
        self.layers = [(tensor(W), tensor(b)) for W, b in model.layers]

    def scaled(self, xi: Any) -> torch.Tensor:
        import torch

        return (torch.as_tensor(xi, dtype=torch.float32, device=self.center.device) - self.center) / self.scale

    def unscaled(self, u: torch.Tensor) -> Any:
        return (u * self.scale + self.center).cpu().numpy().astype(np.float64)

    def clamp(self, u: torch.Tensor) -> torch.Tensor:
        import torch

        return torch.cat([u[..., :2].clamp(-1, 1), u[..., 2:]], dim=-1)

    def cost(self, placements: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        """Return ``J_seq`` (B,) of scaled planar parameters (B, N, 3)."""
        import torch

        middle = self.energies(placements.to(u.device), u * self.scale + self.center)
        ends = self.ends[:, None, None].expand(2, len(u), 1, -1)
        return sequence_cost(torch.cat([ends[0], middle, ends[1]], dim=1), self.options)

    def energies(self, placements: torch.Tensor, xi: torch.Tensor) -> torch.Tensor:
        """Return energies (B, N, A) at placement numbers (B, N) and planar parameters (B, N, 3)."""
        import torch

        yaw = xi[..., 2]
        turned = torch.stack([torch.ones_like(yaw), torch.cos(yaw), torch.sin(yaw)], dim=-1)
        own = (self.of_placement[placements][..., None] * turned[..., None, :]).flatten(-2)  # (B, N, 3 S)
        z = torch.cat([own, xi[..., :2]], dim=-1) @ self.first
        z = z.unflatten(-1, (self.grasps, -1))
        learned = evaluate(self.network, self.layers, self.model.activation, self.model.bounded, z)[..., 0]
        if self.rule is None:
            return learned
        ruled_out = self.rule(placements.cpu().numpy(), xi.detach().cpu().numpy().astype(np.float64))[..., self.ids]
        return torch.where(torch.as_tensor(ruled_out, device=learned.device), BLOCKED, learned)
