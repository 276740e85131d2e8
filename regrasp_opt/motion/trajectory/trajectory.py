"""Joint trajectories: cubic Hermite pieces between knots, whose derivatives have closed-form extremes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from regrasp_opt.conventions import FloatArray


class MotionLimits(NamedTuple):
    """The largest speeds, accelerations and jerks (dof,) [rad/s, rad/s^2, rad/s^3]; prismatic joints: metres."""

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A continuously differentiable motion of all joints, M knots joined by cubics.

    Those of a solved motion are cubic splines: their accelerations are continuous, too.

    Attributes
    ----------
    times : (M,)
        Ascending, from 0 [s].
    positions, velocities : (M, dof)
        At the knots [rad, rad/s] (prismatic joints: [m, m/s]).
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.times[-1])

    @cached_property
    def coefficients(self) -> FloatArray:
        """Coefficients (4, M-1, dof) of each piece over its own parameter u in [0, 1]: ``sum_k c_k u^k``."""
        step = np.diff(self.positions, axis=0)
        h = np.diff(self.times)[:, None]
        first, last = h * self.velocities[:-1], h * self.velocities[1:]
        return np.stack([self.positions[:-1], first, 3 * step - 2 * first - last, first + last - 2 * step])

    def at(self, t: ArrayLike) -> FloatArray:
        """Return the positions (..., dof) at times `t` (...) [s]; before the start and after the end it rests."""
        positions: FloatArray = self._spline(np.clip(t, 0.0, self.duration))
        return positions

    def velocity_at(self, t: ArrayLike) -> FloatArray:
        """Return the velocities (..., dof) at times `t` (...) [s] within the trajectory."""
        velocities: FloatArray = self._spline(np.clip(t, 0.0, self.duration), 1)
        return velocities

    def acceleration_at(self, t: ArrayLike) -> FloatArray:
        """Return the accelerations (..., dof) at times `t` (...) [s]; where they jump, those after the jump."""
        accelerations: FloatArray = self._spline(np.clip(t, 0.0, self.duration), 2)
        return accelerations

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.times, self.positions, self.velocities)

    def position_range(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the greatest position (dof,) of each joint over all times."""
        c0, c1, c2, c3 = self.coefficients
        extremes = [self.positions]
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(c2**2 - 3 * c1 * c3)
            for u in (-c1 / (c2 + root), -c1 / (c2 - root)):  # also where the cubic term vanishes
                inside = np.where((u > 0) & (u < 1), u, 0.0)
                extremes.append(c0 + inside * (c1 + inside * (c2 + inside * c3)))
        values = np.concatenate(extremes)
        return values.min(axis=0), values.max(axis=0)

    def peak_velocity(self) -> FloatArray:
        """Return the largest speed (dof,) of each joint."""
        _, c1, c2, c3 = self.coefficients
        with np.errstate(divide="ignore", invalid="ignore"):
            u = -c2 / (3 * c3)
        u = np.where((u > 0) & (u < 1), u, 0.0)
        inner = (c1 + u * (2 * c2 + 3 * u * c3)) / np.diff(self.times)[:, None]
        return np.concatenate([np.abs(self.velocities), np.abs(inner)]).max(axis=0)

    def peak_acceleration(self) -> FloatArray:
        """Return the largest acceleration (dof,) of each joint; it is linear on each piece."""
        _, _, c2, c3 = self.coefficients
        squared = np.diff(self.times)[:, None] ** 2
        return np.abs(np.concatenate([2 * c2, 2 * c2 + 6 * c3]) / np.tile(squared, (2, 1))).max(axis=0)

    def peak_jerk(self) -> FloatArray:
        """Return the largest jerk (dof,) of each joint; it is constant on each piece."""
        return np.abs(6 * self.coefficients[3] / np.diff(self.times)[:, None] ** 3).max(axis=0)

    def slowed(self, factor: float) -> Trajectory:
        """Return the same path taken `factor` times as slowly."""
        return Trajectory(self.times * factor, self.positions, self.velocities / factor)

    def within(self, limits: MotionLimits) -> Trajectory:
        """Return it slowed down, if needed, to `limits`."""
        factor = max(
            (self.peak_velocity() / limits.velocity).max(),
            np.sqrt((self.peak_acceleration() / limits.acceleration).max()),
            np.cbrt((self.peak_jerk() / limits.jerk).max()),
        )
        return self.slowed(float(factor) * (1 + 1e-9)) if factor > 1 else self

    def reversed(self) -> Trajectory:
        """Return the same path backwards in time."""
        return Trajectory(self.duration - self.times[::-1], self.positions[::-1], -self.velocities[::-1])

    def split(self, cuts: FloatArray) -> list[Trajectory]:
        """Return the parts before, between and after the times `cuts` (C,), ascending and not those of knots."""
        index = np.searchsorted(self.times, cuts)
        times = np.insert(self.times, index, cuts)
        positions = np.insert(self.positions, index, self.at(cuts), axis=0)
        velocities = np.insert(self.velocities, index, self.velocity_at(cuts), axis=0)
        edges = [0, *(index + np.arange(len(index))).tolist(), len(times) - 1]
        return [
            Trajectory(times[a : b + 1] - times[a], positions[a : b + 1], velocities[a : b + 1])
            for a, b in itertools.pairwise(edges)
        ]


def joined(parts: list[Trajectory]) -> Trajectory:
    """Return `parts`, each of which begins where the one before it ends, and as fast, as one trajectory."""
    starts = np.cumsum([0.0, *(part.duration for part in parts[:-1])])
    return Trajectory(
        np.concatenate([[0.0], *(part.times[1:] + t for part, t in zip(parts, starts, strict=True))]),
        np.concatenate([parts[0].positions[:1], *(part.positions[1:] for part in parts)]),
        np.concatenate([parts[0].velocities[:1], *(part.velocities[1:] for part in parts)]),
    )
