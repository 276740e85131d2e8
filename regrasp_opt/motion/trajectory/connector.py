"""Verified trajectories between two configurations, and along straight lines of the tool."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory.cartesian_path import line
from regrasp_opt.motion.trajectory.collision_context import CollisionContext
from regrasp_opt.motion.trajectory.continuous_collision import verify
from regrasp_opt.motion.trajectory.sampling import polyline
from regrasp_opt.motion.trajectory.time_parameterization import (
    LINE_GRID,
    PATH_GRID,
    fastest,
    rest_to_rest,
    rounded,
    through,
)
from regrasp_opt.motion.trajectory.trajectory import MotionLimits, Trajectory, joined
from regrasp_opt.robots import Robot

ROUNDING = (0.4, 0.15, 0.05)
"""Spacings of control points along a polyline that are tried, the smoothest first [rad, m]."""


@dataclass(frozen=True, eq=False)
class Connector:
    """Finds verified trajectories for one robot within its limits.

    Attributes
    ----------
    robot : Robot
    limits : MotionLimits
    distances : tuple of float
        Lengths of straight lines of the tool that are tried, in that order [m].
    """

    robot: Robot
    limits: MotionLimits
    distances: tuple[float, ...]

    def away(self, context: CollisionContext, q: FloatArray, directions: FloatArray) -> Trajectory | None:
        """Return a verified straight tool motion from `q` (dof,) along one of `directions` (D, 3), base frame."""
        for direction, length in itertools.product(directions, self.distances):
            waypoints = line(self.robot, q, direction, length)
            if waypoints is None:
                continue
            trajectory = fastest(through(waypoints), self.limits, LINE_GRID)
            if self.accepted(context, trajectory):
                return trajectory
        return None

    def straight(self, context: CollisionContext, start: FloatArray, goal: FloatArray) -> Trajectory | None:
        """Return the straight motion in joint space between configurations (dof,), if it is verified."""
        trajectory = rest_to_rest(start, goal, self.limits)
        return trajectory if self.accepted(context, trajectory) else None

    def around(
        self, context: CollisionContext, start: FloatArray, goal: FloatArray, rng: np.random.Generator, iterations: int
    ) -> Trajectory | None:
        """Return a verified motion between configurations (dof,) that a sampling planner found, rounded if possible."""
        limits = self.robot.lower, self.robot.upper
        corners = polyline(context, start, goal, limits, rng, iterations=iterations)
        if corners is None:
            return None
        for spacing in ROUNDING:
            trajectory = fastest(rounded(corners, spacing), self.limits, PATH_GRID)
            if self.accepted(context, trajectory):
                return trajectory
        legs = [rest_to_rest(a, b, self.limits) for a, b in itertools.pairwise(corners)]
        trajectory = joined(legs)
        return trajectory if self.accepted(context, trajectory) else None

    def accepted(self, context: CollisionContext, trajectory: Trajectory) -> bool:
        """Return whether `trajectory` stays within the joint limits and is verified free of collision."""
        low, high = trajectory.position_range()
        return self.robot.within_limits(low) and self.robot.within_limits(high) and verify(context, trajectory)
