"""`J_seq` with its gradient for batches of sequences, as Langevin dynamics walks on it, in torch or in NumPy.

Both work in single precision and with the grasps that can matter. torch takes large batches, on a GPU too; NumPy takes
a few sequences without importing torch. The first layer is affine in (1, cos, sin) of the yaw and in x and y at
each placement.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.special import expit

from regrasp_opt.connectivity import BLOCKED, SequenceObjective, sequence_cost
from regrasp_opt.connectivity.costs import pair_weights
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.energy.network import TorchNetwork, activate_with_slope, evaluate
from regrasp_opt.errors import OptionError

if TYPE_CHECKING:
    import torch


class Landscape(Protocol):
    """A cost that can be descended."""

    grasps: int

    def __call__(self, placements: IntArray, xi: FloatArray, blocked: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return ``J_seq`` (B,) and its gradient (B, N, 3) at `placements` (B, N) and `xi` (B, N, 3).

        Grasps that are `blocked` (B, N, G) are taken as `BLOCKED` there.
        """
        ...


class NumPyLandscape:
    """The landscape of sequences with `num_regrasps` poses; the truncated cost has no gradient here."""

    def __init__(self, objective: SequenceObjective, num_regrasps: int) -> None:
        if objective.options.variant == "Jh":
            raise OptionError("the truncated cost Jh has no useful gradient; use variant J or J+, or Langevin in torch")
        energy = objective.energy
        self.model, self.options = energy.model, objective.options
        self.ids = objective.useful_grasps(num_regrasps)
        self.grasps = len(self.ids)
        planar = energy.planar_layers(objective.placements, self.ids)
        parts = np.array([[layer.constant.T, layer.cosine.T, layer.sine.T] for layer in planar])
        self.first = parts.astype(np.float32)  # (S, 3, A, H)
        self.shift = np.array([np.hstack([layer.dx, layer.dy]) for layer in planar]).astype(np.float32)  # (S, H, 2)
        self.ends = np.stack([objective.start_energy[self.ids], objective.goal_energy[self.ids]])

    def __call__(self, placements: IntArray, xi: FloatArray, blocked: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return ``J_seq`` (B,) and its gradient (B, N, 3)."""
        yaw = xi[..., 2, None, None].astype(np.float32)
        constant, cosine, sine = np.moveaxis(self.first[placements], 2, 0)  # (B, N, A, H) each
        c, s = np.cos(yaw), np.sin(yaw)
        shift = self.shift[placements]  # (B, N, H, 2)
        moved = (shift @ xi[..., :2, None].astype(np.float32))[..., 0]
        z = constant + c * cosine + s * sine + moved[..., None, :]
        slopes, layers = [], self.model.layers
        for W, b in layers:
            a, slope = activate_with_slope(self.model.activation, z)
            slopes.append(slope)
            z = a @ W.T + b
        f = z[..., 0]
        learned = np.logaddexp(f, 0) if self.model.bounded else f
        blocked = blocked[..., self.ids]
        middle = np.where(blocked, np.float32(BLOCKED), learned).astype(np.float64)
        ends = np.broadcast_to(self.ends[:, None, None], (2, len(xi), 1, self.grasps))
        energies = np.concatenate([ends[0], middle, ends[1]], axis=1)
        weight = pair_weights(energies, self.options)[:, 1:-1]  # dJ/dE (B, N, A)
        back = np.where(blocked, 0.0, weight * expit(f) if self.model.bounded else weight)[..., None].astype(np.float32)
        for (W, _), slope in zip(reversed(layers), reversed(slopes), strict=True):
            back = (back @ W) * slope
        turn = (back * (c * sine - s * cosine)).sum(axis=(2, 3))
        move = (back.sum(axis=2)[..., None, :] @ shift)[..., 0, :]
        return sequence_cost(energies, self.options), np.concatenate([move, turn[..., None]], axis=-1).astype(
            np.float64
        )


class TorchLandscape:
    """The same on a torch device; pre-activations of a pose for all grasps are one row of a matrix product."""

    def __init__(self, objective: SequenceObjective, num_regrasps: int, device: torch.device) -> None:
        import torch

        def tensor(array: Any) -> torch.Tensor:
            return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=device)

        energy, model = objective.energy, objective.energy.model
        self.options, self.device = objective.options, device
        self.ids = objective.useful_grasps(num_regrasps)
        self.grasps = len(self.ids)
        self.model, self.network = model, TorchNetwork()
        self.ends = tensor(np.stack([objective.start_energy[self.ids], objective.goal_energy[self.ids]]))
        planar = energy.planar_layers(objective.placements, self.ids)
        rows = [np.broadcast_to(part, planar[0].constant.shape) for layer in planar for part in layer]
        self.first = tensor(np.stack([row.T.ravel() for row in rows]))  # (5 S, A H)
        self.of_placement = torch.eye(len(planar), device=device)
        self.layers = [(tensor(W), tensor(b)) for W, b in model.layers]

    def __call__(self, placements: IntArray, xi: FloatArray, blocked: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return ``J_seq`` (B,) and its gradient (B, N, 3)."""
        import torch

        at = torch.as_tensor(xi, dtype=torch.float32, device=self.device).requires_grad_(True)
        middle = self._learned(torch.as_tensor(placements, device=self.device), at)
        middle = torch.where(torch.as_tensor(blocked[..., self.ids], device=self.device), BLOCKED, middle)
        ends = self.ends[:, None, None].expand(2, len(xi), 1, -1)
        cost = sequence_cost(torch.cat([ends[0], middle, ends[1]], dim=1), self.options)
        (gradient,) = torch.autograd.grad(cost.sum(), at)
        return cost.detach().cpu().numpy().astype(np.float64), gradient.cpu().numpy().astype(np.float64)

    def _learned(self, placements: torch.Tensor, xi: torch.Tensor) -> torch.Tensor:
        """Return energies (B, N, A) at placement numbers (B, N) and planar parameters (B, N, 3)."""
        import torch

        yaw = xi[..., 2]
        moved = torch.stack([torch.ones_like(yaw), torch.cos(yaw), torch.sin(yaw), xi[..., 0], xi[..., 1]], dim=-1)
        own = (self.of_placement[placements][..., None] * moved[..., None, :]).flatten(-2)  # (B, N, 5 S)
        z = own @ self.first
        z = z.unflatten(-1, (self.grasps, -1))
        learned: torch.Tensor = evaluate(self.network, self.layers, self.model.activation, self.model.bounded, z)[
            ..., 0
        ]
        return learned
