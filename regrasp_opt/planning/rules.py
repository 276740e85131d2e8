"""What is known exactly of grasps before any of them is checked, whatever energy ranks them.

A grasp is ruled out at a pose where the table, the object or an obstacle is in the way of the tool or the wrist for
certain. The cost, the lattice, Langevin and Ipopt take such grasps as `BLOCKED`.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from regrasp_opt.connectivity import TableRule
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, planar_transform
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.held_tool import wrist_in_object
from regrasp_opt.feasibility.obstacles import ObstacleRule
from regrasp_opt.feasibility.tabletop import points_in_table
from regrasp_opt.objects import ObjectModel


class GraspRules:
    """The exact rules of one object in one workcell, each made when it is first used.

    Parameters
    ----------
    checker : FeasibilityChecker
        Of G grasps.
    body : ObjectModel
    placements : (S, 4, 4)
        Stable placements, T_world_object at xi = 0.
    without_obstacles : GraspRules, optional
        The rules of the same problem with other obstacles; all but those of the obstacles are taken from there.
    """

    def __init__(
        self,
        checker: FeasibilityChecker,
        body: ObjectModel,
        placements: FloatArray,
        without_obstacles: GraspRules | None = None,
    ) -> None:
        self._checker, self._body, self._placements = checker, body, placements
        self._same = without_obstacles

    @cached_property
    def table(self) -> TableRule:
        """Which grasps the table makes infeasible at a placement, whatever the planar parameters."""
        if self._same is not None:
            return self._same.table
        table = self._checker.workcell.table
        corners = table.center + np.array([[-0.5], [0.5]]) * table.size
        return TableRule(points_in_table(self._checker.workcell, self._checker.grasps, self._placements), corners)

    @cached_property
    def never(self) -> BoolArray:
        """Which grasps (G,) put the wrist into the object."""
        if self._same is not None:
            return self._same.never
        return wrist_in_object(self._checker.workcell, self._body, self._checker.grasps)

    @cached_property
    def obstacles(self) -> ObstacleRule | None:
        """What the obstacles rule out; None where there is none."""
        return ObstacleRule(self._checker) if self._checker.workcell.obstacles else None

    def free_space(self, placements: IntArray, xi: FloatArray) -> BoolArray:
        """Return which grasps (..., G) table and object rule out at `placements` (...) and `xi` (..., 3)."""
        return self.table(placements, xi) | self.never

    def behind_obstacles(self, placements: IntArray, xi: FloatArray, candidates: BoolArray) -> BoolArray:
        """Return which of the `candidates` (..., G) the obstacles rule out."""
        if self.obstacles is None:
            return np.zeros_like(candidates)
        T = (planar_transform(xi) @ self._placements[placements]).reshape(-1, 4, 4)
        return self.obstacles(T, candidates.reshape(-1, candidates.shape[-1])).reshape(candidates.shape)

    def __call__(self, placements: IntArray, xi: FloatArray) -> BoolArray:
        """Return which grasps (..., G) are ruled out by any of the rules."""
        ruled_out = self.free_space(placements, xi)
        return ruled_out | self.behind_obstacles(placements, xi, ~ruled_out)
