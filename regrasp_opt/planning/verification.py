"""Hard verification: what turns a promising sequence of poses into a plan.

`PoseFeasibility` remembers the exact checks of one pose, so that no (pose, grasp) pair is checked twice. A transition
is verified with as few checks as possible, the most promising grasps first; all of its shared grasps are enumerated,
with the joint configurations to pick and place them, when somebody looks at it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from typing import overload

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.planning.at_rest import GivenPose
from regrasp_opt.planning.plan_data import Transition

_CHUNK = 8
"""Grasps that are checked at once before looking whether one sufficed."""


class PoseFeasibility:
    """What is known exactly about the G grasps at one object pose `T` (4, 4); all if `feasible` (G,) is given.

    `given` is what a start or goal was given as, if that is another pose.
    """

    def __init__(
        self,
        checker: FeasibilityChecker,
        T: FloatArray,
        feasible: BoolArray | None = None,
        given: GivenPose | None = None,
    ) -> None:
        self.T, self.given = T, given
        self._checker = checker
        self._known = np.full(len(checker.grasps), feasible is not None)
        self._feasible = np.zeros(len(checker.grasps), dtype=bool) if feasible is None else feasible

    @property
    def members(self) -> Sequence[PoseFeasibility]:
        """The poses that count as this one."""
        return (self,)

    def beside(self, neighbor: PoseFeasibility) -> PoseFeasibility:
        """Return the one of the `members` that shares the most grasps with the pose before it."""
        if len(self.members) == 1:
            return self
        return max(self.members, key=lambda pose: np.count_nonzero(pose.all() & neighbor.all()))

    @cached_property
    def object_collides(self) -> bool:
        """Whether the object itself cannot stand here."""
        return self._checker.object_collides(self.T)

    def feasible(self, grasp_ids: IntArray) -> BoolArray:
        """Return the exact feasibility (K,) of `grasp_ids` (K,), checking those that are not known yet."""
        missing = grasp_ids[~self._known[grasp_ids]]
        if len(missing):
            self._feasible[missing] = self._checker.feasible(self.T, missing)
            self._known[missing] = True
        return self._feasible[grasp_ids]

    def all(self) -> BoolArray:
        """Return the exact feasibility (G,) of every grasp."""
        return self.feasible(np.arange(len(self._known)))

    def possible(self) -> BoolArray:
        """Return the grasps (G,) that are feasible or not yet known to be infeasible."""
        return self._feasible | ~self._known


def share_a_grasp(a: PoseFeasibility, b: PoseFeasibility, promise: FloatArray) -> bool:
    """Return whether some grasp is feasible at both poses; grasps with low `promise` (G,) are tried first."""
    ids = np.flatnonzero(a.possible() & b.possible())
    ids = ids[np.argsort(promise[ids], kind="stable")]
    for first in range(0, len(ids), _CHUNK):
        chunk = ids[first : first + _CHUNK]
        chunk = chunk[a.feasible(chunk)]
        if len(chunk) and b.feasible(chunk).any():
            return True
    return False


def verify_sequence(poses: list[PoseFeasibility], energies: FloatArray) -> bool:
    """Return whether every neighbouring pair of `poses` shares a grasp; `energies` (N+2, G) say where to look first.

    The two ends come first: their feasible grasps are known, so they reject for the fewest checks.
    """
    pairs = sorted(range(len(poses) - 1), key=lambda i: (i not in (0, len(poses) - 2), i))
    return all(share_a_grasp(poses[i], poses[i + 1], energies[i] + energies[i + 1]) for i in pairs)


def enumerate_transition(checker: FeasibilityChecker, a: PoseFeasibility, b: PoseFeasibility) -> Transition:
    """Return the transition between two poses with all shared grasps, their configurations and clearances.

    Of each grasp's collision-free branches at both poses, those are taken with the smallest largest joint move; whole
    turns are added at the second pose where the joint limits allow it.
    """
    ids = np.flatnonzero(a.all() & b.all())
    ends = [_Branches(checker, pose.T, ids) for pose in (a, b)]
    kept: list[int] = []
    picks, places, clearances = [], [], []
    for k, grasp_id in enumerate(ids.tolist()):
        pair = _nearest_free_pair(ends[0].of(k), ends[1].of(k), checker)
        if pair is None:  # among all branches, the free one fell to a near-equal one that is not
            continue
        q_pick, q_place = pair
        kept.append(grasp_id)
        picks.append(q_pick)
        places.append(q_place)
        clearances.append(min(checker.clearance(a.T, grasp_id, q_pick), checker.clearance(b.T, grasp_id, q_place)))
    assert kept or not len(ids), "no free pair of configurations for any grasp that was verified at both poses"
    shape = (len(kept), checker.workcell.arm.robot.dof)
    return Transition(
        np.array(kept, dtype=np.int64),
        np.array(picks, dtype=np.float64).reshape(shape),
        np.array(places, dtype=np.float64).reshape(shape),
        np.array(clearances, dtype=np.float64),
        checker.workcell.arm.name,
    )


class LazyTransitions(Sequence[Transition]):
    """The transitions of a verified chain of poses, each enumerated when somebody looks at it."""

    def __init__(self, checker: FeasibilityChecker, chain: Sequence[PoseFeasibility]) -> None:
        self._checker, self._chain = checker, tuple(chain)
        self._found: list[Transition | None] = [None] * (len(chain) - 1)
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._found)

    @overload
    def __getitem__(self, index: int) -> Transition: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Transition, ...]: ...
    def __getitem__(self, index: int | slice) -> Transition | tuple[Transition, ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(len(self))[index])
        number = range(len(self))[index]
        with self._lock:
            found = self._found[number] or enumerate_transition(self._checker, *self._chain[number : number + 2])
            self._found[number] = found
        return found

    def shared(self, index: int) -> IntArray:
        """Return the grasps (K,) that are feasible at both poses of a transition, without enumerating it."""
        a, b = self._chain[index : index + 2]
        return np.flatnonzero(a.all() & b.all())

    def __reduce__(self) -> tuple[type[tuple[Transition, ...]], tuple[tuple[Transition, ...]]]:
        return tuple, (tuple(self),)


class _Branches:
    """All inverse-kinematics branches of some grasps at one pose; collision is tested when asked for, once."""

    def __init__(self, checker: FeasibilityChecker, T: FloatArray, grasp_ids: IntArray) -> None:
        self._checker, self._T, self._ids = checker, T, grasp_ids
        self._branches = checker.branches(np.broadcast_to(T, (len(grasp_ids), 4, 4)), grasp_ids)

    def of(self, k: int) -> tuple[FloatArray, Callable[[int], bool]]:
        """Return the branches (M, dof) of the k-th grasp and whether its m-th one is free of collision."""
        q = self._branches.q[self._branches.pair == k]

        @cache
        def free(m: int) -> bool:
            return self._checker.is_free(self._T, int(self._ids[k]), q[m])

        return q, free


def _nearest_free_pair(
    pick: tuple[FloatArray, Callable[[int], bool]],
    place: tuple[FloatArray, Callable[[int], bool]],
    checker: FeasibilityChecker,
) -> tuple[FloatArray, FloatArray] | None:
    """Return the free pick and place configurations (dof,) with the smallest largest joint move between, or None."""
    targets = checker.workcell.arm.robot.nearest_equivalent(place[0][None], pick[0][:, None])
    move = np.abs(pick[0][:, None] - targets).max(axis=2)
    for index in np.argsort(move, axis=None, kind="stable").tolist():
        i, j = divmod(index, len(place[0]))
        if pick[1](i) and place[1](j):
            return pick[0][i], targets[i, j]
    return None
