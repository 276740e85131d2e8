"""What a search may use: rests and grasps. What is left out counts as infeasible everywhere; numbers stay the same."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from regrasp_opt.connectivity import CostOptions, SequenceObjective
from regrasp_opt.connectivity.embedding import ProblemEnergy
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.errors import OptionError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.planning.rests import Rests
from regrasp_opt.planning.rules import GraspRules
from regrasp_opt.solvers import PoseLattice

_AT_ONCE = 20_000
"""Tool poses about which a choice of grasps is asked together."""

GraspChoice = Callable[[FloatArray], BoolArray]
"""Returns which of tool poses (M, 4, 4) T_world_tcp may be used (M,)."""


def from_above(angle: float = np.pi / 6) -> GraspChoice:
    """Return the choice of grasps whose approach points down, to within `angle` [rad]."""

    def chosen(T_world_tcp: FloatArray) -> BoolArray:
        return np.asarray(-T_world_tcp[..., 2, 2] >= np.cos(angle) - 1e-12)

    return chosen


@dataclass(frozen=True, eq=False)
class SearchFilter:
    """What a search may use.

    Attributes
    ----------
    rests : (R,) int
        Numbers of the rests at which the object may be put down between start and goal.
    mask : (G,) bool
        Grasps that may be used.
    choice : callable or None
        A `GraspChoice` that those of `mask` must pass at both poses of a transition.
    """

    rests: IntArray
    mask: BoolArray
    choice: GraspChoice | None
    T_object_tcp: FloatArray

    def pairs(self, T: FloatArray, grasp_ids: IntArray) -> BoolArray:
        """Return which of M pairs of object poses `T` (M, 4, 4) and `grasp_ids` (M,) may be used."""
        found = self.mask[grasp_ids]
        asked = np.flatnonzero(found) if self.choice is not None else np.zeros(0, dtype=np.int64)
        for first in range(0, len(asked), _AT_ONCE):
            part = asked[first : first + _AT_ONCE]
            assert self.choice is not None
            verdict = np.asarray(self.choice(T[part] @ self.T_object_tcp[grasp_ids[part]]))
            if verdict.shape != part.shape or verdict.dtype != bool:
                what = f"shape {verdict.shape} of {verdict.dtype}"
                raise OptionError(f"grasps returned {what} for {len(part)} tool poses; return True or False for each")
            found[part] = verdict
        return found

    def allowed(self, T: FloatArray, candidates: BoolArray | None = None) -> BoolArray:
        """Return which grasps (B, G), of the `candidates` (B, G), may be used at object poses `T` (B, 4, 4)."""
        found = np.ones((len(T), len(self.mask)), dtype=bool) if candidates is None else candidates.copy()
        pose, grasp = np.nonzero(found)
        found[pose, grasp] = self.pairs(T[pose], grasp)
        return found


def filtered(
    problem: RegraspProblem,
    placements: Iterable[int] | None = None,
    supports: Iterable[str] | None = None,
    grasps: Any = None,
) -> RegraspProblem:
    """Return `problem` for searches that use only these; `solve_sequence` says what they are.

    Raises
    ------
    OptionError, UnknownNameError
        For a placement or support that does not exist, a mask of another length, or where nothing is left.
    """
    if placements is None and supports is None and grasps is None:
        return problem
    names = None if supports is None else {problem.workcell.support(name).name for name in supports}
    numbers = None if placements is None else _numbers(placements)
    known = {rest.placement for rest in problem.rests}
    if numbers is not None and not numbers <= known:
        raise OptionError(f"there is no placement {min(numbers - known)}; '{problem.object.name}' has {sorted(known)}")
    rests = [
        k
        for k, rest in enumerate(problem.rests)
        if (names is None or rest.support.name in names) and (numbers is None or rest.placement in numbers)
    ]
    if not rests:
        raise OptionError("placements and supports together leave no way to put the object down; allow more")
    count, choice = len(problem.grasps), grasps if callable(grasps) else None
    mask = np.ones(count, dtype=bool) if grasps is None or choice is not None else _mask(grasps, count)
    kept = SearchFilter(np.array(rests, dtype=np.int64), mask, choice, problem.grasps.T_object_tcp)
    view = _FilteredProblem(**{each.name: getattr(problem, each.name) for each in fields(problem)})
    vars(view).update(source=problem, kept=kept)
    return view


def _numbers(placements: Any) -> set[int]:
    given = list(placements) if isinstance(placements, Iterable) else [placements]
    if not all(isinstance(each, (int, np.integer)) and not isinstance(each, bool) for each in given):
        raise OptionError(f"placements is {placements!r}; give whole numbers, such as [0, 2]")
    return set(map(int, given))


def _mask(grasps: Any, count: int) -> BoolArray:
    """Return the mask (count,) that a mask or a list of grasp numbers stands for."""
    given = np.asarray(grasps)
    if given.dtype == bool and given.shape == (count,):
        mask = given.copy()
    elif given.ndim == 1 and given.dtype.kind in "iu" and ((given >= 0) & (given < count)).all():
        mask = np.isin(np.arange(count), given)
        if mask.sum() < len(given):
            raise OptionError("grasps has a number twice; give each once, or a mask of True and False")
    else:
        raise OptionError(f"grasps has shape {given.shape}; give a mask ({count},), grasp numbers or a callable")
    if not mask.any():
        raise OptionError("grasps leaves none of the grasps; choose at least one")
    return mask


class _FilteredChecker:
    """A checker to which grasps that are left out are infeasible."""

    def __init__(self, checker: FeasibilityChecker, kept: SearchFilter) -> None:
        self._checker, self._kept = checker, kept

    def __getattr__(self, name: str) -> Any:
        return getattr(self._checker, name)

    def feasible(self, T: FloatArray, grasp_ids: IntArray | None = None) -> BoolArray:
        ids = np.arange(len(self._kept.mask)) if grasp_ids is None else np.asarray(grasp_ids, dtype=np.int64)
        return self.feasible_pairs(np.broadcast_to(T, (len(ids), 4, 4)), ids)

    def feasible_pairs(self, T: FloatArray, grasp_ids: IntArray) -> BoolArray:
        found = self._kept.pairs(T, grasp_ids)
        found[found] = self._checker.feasible_pairs(T[found], grasp_ids[found])
        return found


class _FilteredProblem(RegraspProblem):
    """A problem for one search, which shares with its `source` all that the filter does not touch."""

    source: RegraspProblem
    kept: SearchFilter

    @property
    def original(self) -> RegraspProblem:
        return self.source

    @property
    def choices(self) -> IntArray:
        return self.kept.rests

    @cached_property
    def checker(self) -> FeasibilityChecker:
        checker: Any = _FilteredChecker(self.source.checker, self.kept)
        return checker

    @property
    def rests(self) -> Rests:
        return self.source.rests

    @property
    def energy(self) -> ProblemEnergy:
        return self.source.energy

    @property
    def rules(self) -> GraspRules:
        return self.source.rules

    @property
    def lattice(self) -> PoseLattice:
        """The poses of the original's lattice that may be used; a choice of grasps is asked about them lazily."""
        free, kept = self.source.free_lattice, self.kept
        there = np.isin(free.placements, kept.rests)
        part = free if there.all() and kept.mask.all() else free.part(there, kept.mask)
        return part if kept.choice is None and self.rules.obstacles is None else part.under(self._behind)

    def ruled_out(self, placements: Any, xi: Any, useful: BoolArray | None = None) -> BoolArray:
        numbers, xi = np.asarray(placements), np.asarray(xi, dtype=np.float64)
        out = self.source.ruled_out(numbers, xi, useful) | ~np.isin(numbers, self.kept.rests)[..., None]
        T, asked = self.rests.planar.at(numbers, xi), ~out if useful is None else useful & ~out
        allowed = self.kept.allowed(T.reshape(-1, 4, 4), asked.reshape(-1, asked.shape[-1])).reshape(asked.shape)
        return out | (asked & ~allowed)

    def objective(
        self, start_energy: FloatArray, goal_energy: FloatArray, options: CostOptions | None = None
    ) -> SequenceObjective:
        return replace(super().objective(start_energy, goal_energy, options), choices=self.kept.rests)

    def _behind(self, placements: IntArray, xi: FloatArray, candidates: BoolArray) -> BoolArray:
        left = self.kept.allowed(self.rests.planar.at(placements, xi), candidates)
        return (candidates & ~left) | self.rules.behind_obstacles(placements, xi, left)
