"""What is known exactly of grasps before any of them is checked, whatever energy ranks them.

A grasp is ruled out at a pose where the table, the object or an obstacle is in the way of the tool or the wrist for
certain. The cost, the lattice, Langevin and Ipopt take such grasps as `BLOCKED`.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from regrasp_opt.connectivity import TableRule
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.held_tool import wrist_in_object
from regrasp_opt.feasibility.obstacles import ObstacleRule, ToolShape
from regrasp_opt.feasibility.tabletop import points_in_support
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning.rests import Rests
from regrasp_opt.scene import Support


class GraspRules:
    """The exact rules of one object in one workcell, each made when it is first used.

    Parameters
    ----------
    checker : FeasibilityChecker
        Of G grasps.
    body : ObjectModel
    rests : Rests
    without_obstacles : GraspRules, optional
        The rules of the same problem with other obstacles; all but those of the obstacles are taken from there.
    """

    def __init__(
        self,
        checker: FeasibilityChecker,
        body: ObjectModel,
        rests: Rests,
        without_obstacles: GraspRules | None = None,
    ) -> None:
        self._checker, self._body, self._rests = checker, body, rests
        self._same = without_obstacles

    @cached_property
    def table(self) -> TableRule:
        """Which grasps its support makes infeasible at a placement, whatever the planar parameters."""
        if self._same is not None:
            return self._same.table
        bases, on = self._rests.planar.bases, [rest.support for rest in self._rests]
        edges = [support.edges if isinstance(support, Support) else np.zeros((2, 2)) for support in on]
        points = points_in_support(self._checker.workcell, self._checker.grasps, bases, on)
        return TableRule(points, np.array(edges).reshape(-1, 2, 2))

    @cached_property
    def never(self) -> BoolArray:
        """Which grasps (G,) put the wrist into the object."""
        if self._same is not None:
            return self._same.never
        return wrist_in_object(self._checker.workcell, self._body, self._checker.grasps)

    @cached_property
    def obstacles(self) -> ObstacleRule | None:
        """What obstacles, and supports that the object is not on, rule out; None where there are none."""
        cell = self._checker.workcell
        return ObstacleRule(self._checker, self._tool) if cell.obstacles or len(cell.supports) > 1 else None

    @cached_property
    def _tool(self) -> ToolShape:
        return ToolShape(self._checker.workcell.arm, self._checker.grasps) if self._same is None else self._same._tool

    def free_space(self, placements: IntArray, xi: FloatArray) -> BoolArray:
        """Return which grasps (..., G) table and object rule out at `placements` (...) and `xi` (..., 3)."""
        return self.table(placements, xi) | self.never

    def behind_obstacles(self, placements: IntArray, xi: FloatArray, candidates: BoolArray) -> BoolArray:
        """Return which of the `candidates` (..., G) the obstacles rule out."""
        if self.obstacles is None:
            return np.zeros_like(candidates)
        T, on = self._rests.planar.at(placements, xi).reshape(-1, 4, 4), self._rests.supports[placements].reshape(-1)
        return self.obstacles(T, on, candidates.reshape(-1, candidates.shape[-1])).reshape(candidates.shape)

    def __call__(self, placements: IntArray, xi: FloatArray, useful: BoolArray | None = None) -> BoolArray:
        """Return which grasps (..., G) are ruled out; obstacles are asked about the `useful` (G,), by default all."""
        ruled_out = self.free_space(placements, xi)
        return ruled_out | self.behind_obstacles(placements, xi, ~ruled_out if useful is None else useful & ~ruled_out)
