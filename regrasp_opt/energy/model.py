"""The energy ``E(T, g)``: a small MLP with its weights as NumPy arrays, evaluated without torch.

Low energy means that grasp ``g`` is likely feasible at object pose ``T``. A bounded energy is
``softplus(f) = -log p(feasible)`` of the network's output ``f``, so that summed energies are the negative log of a
product of probabilities (Eqs. 1 and 2) and one very sure pose cannot make up for an infeasible one. The paper's
preset uses ``f`` itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from regrasp_opt.conventions import FloatArray
from regrasp_opt.energy.features import FeatureSet, InputWeights, input_weights, with_tcp_weights
from regrasp_opt.energy.network import Activation, activate, evaluate
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.grasps import GraspSet

_CHUNK_ELEMENTS = 1 << 21
"""Hidden units evaluated at once: bounds the memory of a batch to a few tens of MB."""


@dataclass(frozen=True)
class EnergyModel:
    """A trained energy.

    Layer l maps with ``weights[l]`` (out, in) and ``biases[l]`` (out,); the last layer has one output. `activation`,
    `features`, `use_width` and `bounded` say what the network is; see `regrasp_opt.energy.features` and the module
    docstring. `threshold` is `h` of Eq. 3, calibrated on shared grasps (appendix A): those whose energies sum to at
    most `h`. `metadata` holds provenance and held-out metrics, JSON-serialisable.
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    activation: Activation
    features: FeatureSet
    use_width: bool
    bounded: bool
    threshold: float
    metadata: dict[str, Any] = field(default_factory=dict, compare=False)

    @property
    def layers(self) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]:
        """Weights and biases of the layers after the first, as `regrasp_opt.energy.network` takes them."""
        return tuple(zip(self.weights[1:], self.biases[1:], strict=True))

    @cached_property
    def input_weights(self) -> InputWeights:
        """The first layer's weights by what they weigh."""
        return input_weights(self.weights[0].astype(np.float64), self.features, self.use_width)

    @property
    def hidden(self) -> int:
        """Width of the hidden layers."""
        return int(self.weights[0].shape[0])

    def seen_from(self, T_base_world: FloatArray) -> EnergyModel:
        """Return this energy of tool poses in the base's frame as one of tool poses in the world."""
        if np.array_equal(T_base_world, np.eye(4)):
            return self
        W, tcp = self.weights[0].astype(np.float64), self.input_weights.tcp
        W = with_tcp_weights(W, self.features, np.einsum("ij,ihk->jhk", T_base_world[:3, :3], tcp))
        b = self.biases[0] + np.einsum("i,ih->h", T_base_world[:3, 3], tcp[:, :, 3])
        weights, biases = (W.astype(np.float32), *self.weights[1:]), (b.astype(np.float32), *self.biases[1:])
        return replace(self, weights=weights, biases=biases)

    def fingerprint(self) -> str:
        """Return a hash of everything that the energy's value depends on."""
        return content_hash(*self.weights, *self.biases, self.activation, self.features, self.use_width, self.bounded)


class FirstLayer(NamedTuple):
    """The first layer for one grasp set, affine in the pose: ``z = constant + sum_i (pose[i] + tcp[i] @ g) @ T[i]``.

    `pose` and `tcp` (3, H, 4) are as in `InputWeights`; `constant` (H, G) is what the grasp alone contributes, bias
    included.
    """

    pose: FloatArray
    tcp: FloatArray
    constant: FloatArray


class PlanarLayer(NamedTuple):
    """The first layer at one placement: ``z = constant + cosine cos + sine sin + dx x + dy y`` (Eq. 6).

    ``constant``, ``cosine`` and ``sine`` are (H, G); ``dx`` and ``dy`` are (H, 1), the same for all grasps.
    """

    constant: Any
    cosine: Any
    sine: Any
    dx: Any
    dy: Any


class GraspEnergy:
    """An `EnergyModel` bound to the G grasps of one grasp set; what plans are made with.

    Connectivity is marginalised over these grasps; they need not be those of the training.
    """

    def __init__(self, model: EnergyModel, grasps: GraspSet) -> None:
        self.model = model
        self.grasps = grasps

    @cached_property
    def first_layer(self) -> FirstLayer:
        """The first layer for this grasp set."""
        weights, grasps = self.model.input_weights, self.grasps
        constant = weights.grasp @ grasps.T_object_tcp[:, :3].reshape(-1, 12).T
        constant = constant + self.model.biases[0].astype(np.float64)[:, None] + weights.width[:, None] * grasps.width
        return FirstLayer(weights.pose, weights.tcp, constant)

    def __len__(self) -> int:
        return len(self.grasps)

    def fingerprint(self) -> str:
        """Return a hash of the model and the grasps."""
        return content_hash(self.model.fingerprint(), self.grasps.fingerprint())

    def planar_layers(self, placements: PlanarPoses, grasp_ids: Any = slice(None)) -> list[PlanarLayer]:
        """Return the first layer at each of the `placements` for the chosen grasps, in float64."""
        return [
            self._planar_layer(surface, base, grasp_ids)
            for surface, base in zip(placements.surfaces, placements.bases, strict=True)
        ]

    def _planar_layer(self, surface: FloatArray, base: FloatArray, grasp_ids: Any) -> PlanarLayer:
        """Return the first layer at ``surface @ dT(xi) @ base``, each (4, 4)."""
        first, grasps = self.first_layer, self.grasps.T_object_tcp[grasp_ids]
        turned = np.einsum("ij,nihk->njhk", surface[:3, :3], np.array([first.pose, first.tcp]))  # seen from the surface
        pose, tcp = turned
        shift = turned[..., 3].sum(axis=0)  # (3, H)
        raised = np.einsum("i,ih->h", surface[:3, 3], first.pose[..., 3] + first.tcp[..., 3])[:, None]

        def response(weights_row: int, row: FloatArray) -> FloatArray:
            direct: FloatArray = (pose[weights_row] @ row)[:, None]
            return direct + tcp[weights_row] @ np.einsum("j,gjk->kg", row, grasps)

        r0, r1, r2 = base[:3]
        return PlanarLayer(
            first.constant[:, grasp_ids] + raised + response(2, r2),
            response(0, r0) + response(1, r1),
            response(1, r0) - response(0, r1),
            shift[0][:, None],
            shift[1][:, None],
        )

    def __call__(self, T: FloatArray, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return the energies (..., G) of all grasps at object poses `T` (..., 4, 4) T_world_object.

        ``float32`` is enough to rank poses and about twice as fast; parity with CasADi is stated for ``float64``.
        """
        T = np.asarray(T, dtype=np.float64)
        flat = T.reshape(-1, 4, 4)
        chunk = max(1, _CHUNK_ELEMENTS // max(1, len(self) * self.model.hidden))
        blocks = [self._evaluate(flat[i : i + chunk], np.dtype(dtype)) for i in range(0, len(flat), chunk)]
        out = np.concatenate(blocks) if blocks else np.zeros((0, len(self)), dtype=dtype)
        return out.reshape(*T.shape[:-2], len(self))

    def _evaluate(self, T: FloatArray, dtype: np.dtype[Any]) -> NDArray[Any]:
        first = self.first_layer
        rows = T[:, :3].astype(dtype)  # (B, 3, 4)
        z = np.einsum("bij,ihj->bh", rows, first.pose.astype(dtype))[:, None, :] + first.constant.T.astype(dtype)
        if first.tcp.any():
            grasps = self.grasps.T_object_tcp.astype(dtype).transpose(1, 0, 2).reshape(4, -1)
            tcp = (rows.reshape(-1, 4) @ grasps).reshape(len(T), 3, len(self), 4)
            tcp = tcp.transpose(0, 2, 1, 3).reshape(len(T), len(self), 12)
            weights = first.tcp.transpose(1, 0, 2).reshape(-1, 12).T.astype(dtype)
            z = z + (tcp.reshape(-1, 12) @ weights).reshape(z.shape)
        return self.after_first_layer(z.reshape(-1, z.shape[-1])).reshape(len(T), len(self))

    def after_first_layer(self, z: NDArray[Any]) -> NDArray[Any]:
        """Return the energies (M,) where the first layer's pre-activation is `z` (M, H), in its precision.

        One large product is far cheaper than many small ones.
        """
        model = self.model
        return evaluate(_NumPy(), model.layers, model.activation, model.bounded, z)[:, 0]


class _NumPy:
    """Arrays (M, H) of one dtype; a network's backend."""

    activate = staticmethod(activate)

    def affine(self, a: NDArray[Any], W: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
        return a @ W.T.astype(a.dtype) + b.astype(a.dtype)

    def softplus(self, f: NDArray[Any]) -> NDArray[Any]:
        return np.logaddexp(f, 0)
