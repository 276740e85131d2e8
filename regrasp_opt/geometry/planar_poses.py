"""Poses that keep to a plane: stable placements on supports, each with the planar parameters that it may have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray, IntArray, planar_transform


@dataclass(frozen=True, eq=False)
class PlanarPoses:
    """S placements of an object, ``T_world_object = surface @ dT(xi) @ base`` (Eq. 6) with ``low <= xi <= high``.

    Attributes
    ----------
    surfaces : (S, 4, 4)
        T_world_support: the plane in which `xi` moves the object.
    bases : (S, 4, 4)
        T_support_object at xi = 0.
    low, high : (S, 3)
        Least and largest (x, y, theta) [m, m, rad]; a yaw that is free goes from -inf to inf.
    weights : (S,)
        What each pose in a placement adds to the cost of a sequence.
    """

    surfaces: FloatArray
    bases: FloatArray
    low: FloatArray
    high: FloatArray
    weights: FloatArray

    @staticmethod
    def level(placements: ArrayLike, bounds: ArrayLike) -> PlanarPoses:
        """Return placements on a level surface.

        Parameters
        ----------
        placements : (S, 4, 4)
            T_world_object at xi = 0.
        bounds : (2, 2)
            ``[[x_low, y_low], [x_high, y_high]]`` [m].
        """
        poses = np.asarray(placements, dtype=np.float64)
        low, high = (np.append(side, yaw) for side, yaw in zip(np.asarray(bounds), (-np.inf, np.inf), strict=True))
        count = len(poses)
        low, high = (np.tile(side, (count, 1)) for side in (low, high))
        return PlanarPoses(np.tile(np.eye(4), (count, 1, 1)), poses, low, high, np.zeros(count))

    def __len__(self) -> int:
        return len(self.bases)

    def __getitem__(self, numbers: Any) -> PlanarPoses:
        """Return the placements of these `numbers`, in their order."""
        parts = self.surfaces, self.bases, self.low, self.high, self.weights
        return PlanarPoses(*(part[numbers] for part in parts))

    def at(self, numbers: Any, xi: ArrayLike) -> FloatArray:
        """Return the poses (..., 4, 4) T_world_object of placement `numbers` (...) at `xi` (..., 3)."""
        poses: FloatArray = self.surfaces[numbers] @ (planar_transform(xi) @ self.bases[numbers])
        return poses

    @property
    def rectangle(self) -> FloatArray:
        """The corners (2, 2) of the least rectangle in x and y with all that is allowed [m]."""
        return np.array([self.low[:, :2].min(axis=0), self.high[:, :2].max(axis=0)])

    def draw(self, count: int, rng: np.random.Generator, among: IntArray | None = None) -> tuple[IntArray, FloatArray]:
        """Return random placement numbers (count,), `among` these, and xi (count, 3), uniform within their limits."""
        share = np.column_stack([rng.random((count, 2)), rng.random(count)])
        choices = np.arange(len(self)) if among is None else among
        numbers = choices[rng.integers(len(choices), size=count)]
        return numbers, self.inside(numbers, share)

    def inside(self, numbers: IntArray, share: FloatArray) -> FloatArray:
        """Return the xi (..., 3) that are at `share` (..., 3), 0 to 1, of the way between the limits of `numbers`."""
        low, high = self.low[numbers], self.high[numbers]
        free = ~np.isfinite(high)
        low, high = np.where(free, 0.0, low), np.where(free, 2 * np.pi, high)
        xi: FloatArray = low + (high - low) * share
        return xi

    def wrapped(self, numbers: Any, xi: FloatArray) -> FloatArray:
        """Return `xi` (..., 3) with each yaw in [0, 2 pi) where it is free, and at its value where it is not."""
        out = np.array(xi)
        free = ~np.isfinite(self.high[numbers][..., 2])
        out[..., 2] = np.where(free, out[..., 2] % (2 * np.pi), self.high[numbers][..., 2])
        return out

    def allow(self, numbers: Any, xi: FloatArray, tolerance: float = 1e-9) -> bool:
        """Return whether all `xi` (N, 3) are finite and within the limits of their placements, `numbers` (N,)."""
        within = (xi >= self.low[numbers] - tolerance) & (xi <= self.high[numbers] + tolerance)
        return bool(np.isfinite(xi).all() and within.all())
