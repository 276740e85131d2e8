"""What would help where there is no plan: each change is made, and exact checks say whether there is a plan then.

Whether there is one is decided by exact checks of random resting poses (`regrasp_opt.planning.exact`), so no energy is
needed. Such a search may miss a plan, but never finds a false one: what "helps" has a verified chain of poses behind
it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.end_effectors import END_EFFECTOR_NAMES, EndEffector, load_end_effector
from regrasp_opt.errors import GraspError, PoseError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.diagnosis import Cause, Reason
from regrasp_opt.grasps import GraspSet, sample_grasps
from regrasp_opt.planning.ends import checked_end
from regrasp_opt.planning.exact import MAX_REGRASPS, PORTION, RestingPoses
from regrasp_opt.planning.explanation import Between, Change, Explanation, Remedy, regrasps
from regrasp_opt.planning.pose_text import describe_pose
from regrasp_opt.planning.problem_data import REST_TOLERANCE, ProblemData
from regrasp_opt.scene import Fixture, Workcell
from regrasp_opt.scene.collision_world import collision_at_home

SIZES = (64, 256)
"""Numbers of random resting poses over which a changed task is planned."""
OWN_SIZES = (256, 1024)
"""The same for the task as it is."""
PLACES = 200
"""Places that an end is moved to at most."""
NEAR = 0.1
"""Standard deviation of half of these places from where the end was [m]; the others are anywhere in the workspace."""
TURN_COSTS = 0.05
"""A turn of one radian counts like being moved by so much [m]."""
TURNS = 8
"""Angles at which another placement is tried."""
MORE = 3
"""So many times the grasps are sampled."""
TOOL_GRASPS = 200
"""Grasps that are sampled for another end-effector."""
OBSTACLES_TRIED = 8
"""Obstacles that are taken away one by one at most."""

Ends = dict[str, FloatArray]


class _Plans:
    """Whether there are plans with one workcell and one set of grasps.

    `late` says whether the time is over, and plans have at most `most` regrasps.
    """

    def __init__(
        self, problem: ProblemData, checker: FeasibilityChecker, seed: int, late: Callable[[], bool], most: int
    ) -> None:
        self.checker, self._late, self._most = checker, late, most
        self._known: dict[bytes, BoolArray] = {}
        self.poses = RestingPoses(checker, problem.rests.planar, np.random.default_rng(seed))

    def feasible(self, T: FloatArray) -> BoolArray:
        """Return which grasps (G,) are feasible at `T` (4, 4), remembered."""
        key = T.tobytes()
        if key not in self._known:
            self._known[key] = self.checker.feasible(T)
        return self._known[key]

    def outcome(self, ends: Ends) -> tuple[bool, str, int | None]:
        """Return whether there is a plan between two `ends`, or a feasible grasp at one, in words, and its regrasps."""
        feasible = {name: self.feasible(T) for name, T in ends.items()}
        name = next((name for name, grasps in feasible.items() if not grasps.any()), None)
        if name is not None:
            return False, f"no grasp is feasible at the {name}", None
        if len(ends) == 1:
            (grasps,) = feasible.values()
            return True, f"{grasps.sum()} of {len(grasps)} grasps feasible", None
        start, goal = feasible.values()
        count = self.regrasps(start, goal, self._most)
        return count is not None, self.said(count) if count is not None or self._most else "no shared grasp", count

    def said(self, count: int | None) -> str:
        """Return the outcome of a search in words."""
        if count is None:
            return f"no plan through {self.poses.drawn} random resting poses"
        return f"a plan with {regrasps(count)}" if count else "a plan without a regrasp"

    def regrasps(self, start: BoolArray, goal: BoolArray, most: int, sizes: tuple[int, ...] = SIZES) -> int | None:
        """Return the fewest regrasps between ends with feasible grasps (G,), over growing numbers of random poses."""
        if (start & goal).any():
            return 0
        for size in sizes if most else ():
            while self.poses.drawn < size and not self._late():
                self.poses.grow(min(size, self.poses.drawn + PORTION))
            path = next(self.poses.shortest_paths(start, goal, range(1, most + 1)), None)
            if path is not None:
                return len(path.xi)
        return None


class Remedies:
    """Tries changes to one problem, cheapest first, until the time is over.

    Parameters
    ----------
    problem : ProblemData
    tried : int
        Up to how many regrasps a plan was looked for.
    time_limit : float
        Seconds.
    seed : int
    """

    def __init__(self, problem: ProblemData, tried: int, time_limit: float, seed: int) -> None:
        self._problem, self._tried, self._seed, self._most = problem, tried, seed, MAX_REGRASPS
        self._until = time.perf_counter() + time_limit
        self._found: list[Remedy] = []

    def completed(self, found: Explanation) -> Explanation:
        """Return the explanation with what was tried."""
        poses = [found.poses[0], *found.poses[1:][-1:]]
        ends = {pose.name: pose.T for pose in poses}
        failing = [pose.name for pose in poses if pose.causes]
        refused = any(pose.refused is not None for pose in poses)
        self._most = MAX_REGRASPS if failing else self._tried
        self._plans = self._with(self._problem.workcell, self._problem.grasps)
        if found.causes[0].cause is Cause.GRIPPER_IN_TABLE:
            found = replace(found, causes=(*self._too_wide(found), *found.causes))
        between = None if failing else self._between(ends)
        elsewhere = {Change.PLACE: lambda: self._elsewhere(ends, failing)}  # long where it does not help
        steps: dict[Change, Callable[[], None]] = {Change.OBSTACLE: lambda: self._without_obstacles(ends, found)}
        steps |= elsewhere if failing else {}
        if not refused:
            steps[Change.PLACEMENT] = lambda: self._in_other_placements(ends, failing)
            steps[Change.GRASPS] = lambda: self._with_more_grasps(ends)
            steps[Change.TOOL] = lambda: self._with_other_tools(ends)
        steps |= elsewhere
        untried = []
        for change, step in steps.items() if not any(r.change is Change.SEARCH for r in self._found) else ():
            if self._late():
                untried.append(change)
            else:
                step()
        order = sorted(self._found, key=lambda remedy: (not remedy.helps, list(Change).index(remedy.change)))
        return replace(found, between=between, remedies=tuple(order), untried=tuple(untried))

    def _late(self) -> bool:
        return time.perf_counter() > self._until

    def _with(self, cell: Workcell, grasps: GraspSet) -> _Plans:
        problem = self._problem
        same = cell is problem.workcell and grasps is problem.grasps
        checker = problem.checker if same else FeasibilityChecker(problem.object, cell, grasps)
        return _Plans(problem, checker, self._seed, self._late, self._most)

    def _try(
        self, change: Change, text: str, value: Mapping[str, Any], ends: Ends, plans: _Plans | None = None
    ) -> bool:
        self._found.append(Remedy(change, text, *(plans or self._plans).outcome(ends), value))
        return self._found[-1].helps

    def _fails(self, change: Change, text: str, outcome: str, value: Mapping[str, Any] | None = None) -> None:
        self._found.append(Remedy(change, text, False, outcome, None, value or {}))

    def _between(self, ends: Ends) -> Between:
        """Return what random resting poses have in common with both ends, and keep whether a plan leads over them."""
        start, goal = (self._plans.feasible(T) for T in ends.values())
        count, poses = self._plans.regrasps(start, goal, MAX_REGRASPS, OWN_SIZES), self._plans.poses
        touched = [(poses.feasible & end).any(axis=1) for end in (start, goal)]
        both = int((touched[0] & touched[1]).sum())
        first, last = (tuple(map(self._label, np.unique(poses.numbers[each]).tolist())) for each in touched)
        most, change, text = MAX_REGRASPS, Change.REGRASPS, f"up to {regrasps(MAX_REGRASPS)}"
        if count is not None and count > self._tried:
            most, text = count, f"up to {regrasps(count)}, --max-regrasps {count}"
        elif count is not None:
            most, change, text = self._tried, Change.SEARCH, "random poses, --refiner exact"
        value = {"max_regrasps": most} | ({"refiner": "exact"} if change is Change.SEARCH else {})
        self._found.append(Remedy(change, text, count is not None, self._plans.said(count), count, value))
        with_start, with_goal = (int(each.sum()) for each in touched)
        return Between(poses.drawn, len(poses.xi), with_start, with_goal, both, first, last, count)

    # ---- changes of the scene

    def _without_obstacles(self, ends: Ends, found: Explanation) -> None:
        """Take away the obstacles that are to blame one by one, all if none is, and together if none alone helps."""
        names = [shape.name for shape in self._problem.workcell.obstacles]
        reasons = [str(reason) for pose in found.poses for reason in pose.failures]
        blamed = [name for name in names if any(f"'{name}'" in str(reason) for reason in found.causes)]
        seen = [name for name in names if any(f"obstacle '{name}'" in reason for reason in reasons)]
        refusals = [pose.refused for pose in found.poses if pose.refused is not None]
        if refusals:
            names = seen = blamed = [name for name in names if all(f"'{name}'" in refusal for refusal in refusals)]
        chosen = (blamed or seen or names)[:OBSTACLES_TRIED]
        helped = [self._try_without([name], ends) for name in chosen if not self._late()]
        if len(names) > 1 and not any(helped) and not self._late():
            self._try_without(names, ends)

    def _try_without(self, names: list[str], ends: Ends) -> bool:
        cell = self._problem.workcell
        less = replace(cell, obstacles=tuple(shape for shape in cell.obstacles if shape.name not in names))
        text = "without " + " and ".join(f"'{name}'" for name in names)
        return self._try(Change.OBSTACLE, text, {"without": names}, ends, self._with(less, self._problem.grasps))

    # ---- changes of the poses

    def _elsewhere(self, ends: Ends, failing: list[str]) -> None:
        """Move the ends that fail, nearest places first; where none fails, one end or the other."""
        if len(failing) > 1:  # one to where it can be grasped at all, then the other until there is a plan
            first = self._nearest({failing[0]: ends[failing[0]]}, failing[0])
            self._keep_moved(failing[1], ends, first and self._nearest(ends | first, failing[1]))
        for name in (failing or list(ends)) if len(failing) < 2 else ():
            if not self._late():
                self._keep_moved(name, ends, self._nearest(ends, name))

    def _keep_moved(self, name: str, ends: Ends, moved: Ends | None) -> None:
        if moved is None:
            what = "feasible grasp" if len(ends) == 1 else "plan"
            outcome = "time ran out" if self._late() else f"no {what} from {PLACES} places"
            self._fails(Change.PLACE, f"the {name} elsewhere in its placement", outcome)
            return
        changed = {each: T for each, T in moved.items() if T is not ends[each]}
        text = " and ".join(self._moved(each, ends[each], T) for each, T in changed.items())
        self._try(Change.PLACE, text, {each: T.tolist() for each, T in changed.items()}, moved)

    def _moved(self, name: str, before: FloatArray, after: FloatArray) -> str:
        where = describe_pose(after, self._problem)
        distance = np.linalg.norm(self._center(after) - self._center(before))
        return f"the {name} {1e3 * distance:.0f} mm away at {where}"

    def _center(self, T: FloatArray) -> FloatArray:
        """Return the centre of mass (3,)."""
        center: FloatArray = T[:3, :3] @ self._problem.object.center_of_mass + T[:3, 3]
        return center

    def _label(self, number: int) -> str:
        """Return what a rest is called where poses are written."""
        rest = self._problem.rests[number]
        return rest.label if len(self._problem.workcell.supports) > 1 else str(rest.placement)

    def _rest(self, T: FloatArray) -> tuple[int, FloatArray]:
        """Return the number of the rest that is nearest to `T`, and its xi (3,)."""
        xi, error = self._problem.rests.nearest(T)
        number, _ = self._problem.rests.find(T, REST_TOLERANCE) or (int(error.argmin()), xi)
        return number, xi[number]

    def _nearest(self, ends: Ends, name: str) -> Ends | None:
        """Return the ends with that of this `name` at the nearest place from which there is a plan, or None."""
        for T in self._places(ends[name]):
            if self._late():
                break
            moved = ends | {name: T}
            if self._can_rest(T, name) and self._plans.feasible(T).any() and self._plans.outcome(moved)[0]:
                return moved
        return None

    def _can_rest(self, T: FloatArray, name: str) -> bool:
        try:
            checked_end(T, name, self._problem)
        except PoseError:
            return False
        return True

    def _places(self, T: FloatArray) -> Iterator[FloatArray]:
        """Yield poses in the placement of `T`, or the one nearest to it, by how far they are from it."""
        rng, planar = np.random.default_rng(self._seed), self._problem.rests.planar
        number, here = self._rest(T)
        low, high = planar.low[number], planar.high[number]
        xi = here + np.column_stack([rng.normal(scale=NEAR, size=(PLACES, 2)), np.zeros(PLACES)])
        xi[::2, :2] = rng.uniform(low[:2], high[:2], (len(xi[::2]), 2))
        xi[:, 2] += rng.uniform(-np.pi, np.pi, PLACES) * (rng.random(PLACES) < 0.5)
        xi = np.clip(xi, low, high)
        away = np.linalg.norm(xi[:, :2] - here[:2], axis=1) + TURN_COSTS * np.abs(xi[:, 2] - here[2])
        for k in np.argsort(away)[: 1 if np.isfinite(high[2]) else None]:
            yield planar.at(number, xi[k])

    def _in_other_placements(self, ends: Ends, failing: list[str]) -> None:
        """Put each end that fails, both together, or one or the other if none does, down in other placements there."""
        rests = self._problem.rests
        for names in [failing] if failing else [[name] for name in ends]:
            own = [self._rest(ends[name])[0] for name in names]
            for number in np.flatnonzero(rests.supports == rests.supports[own[0]]).tolist():
                if self._late() or number in own or isinstance(rests[number].support, Fixture):
                    continue
                turned = {name: self._turned(ends[name], name, number) for name in names}
                text = " and ".join(f"the {name} in placement {self._label(number)} where it is" for name in names)
                missing = next((name for name, T in turned.items() if T is None), None)
                if missing is not None:
                    outcome = f"no grasp is feasible at the {missing}, at {TURNS} angles"
                    self._fails(Change.PLACEMENT, text, outcome, {"placement": number})
                    continue
                poses = {name: T for name, T in turned.items() if T is not None}
                where = [f"the {name} at {describe_pose(T, self._problem)}" for name, T in poses.items()]
                value = {name: T.tolist() for name, T in poses.items()}
                self._try(Change.PLACEMENT, " and ".join(where), value, ends | poses)

    def _turned(self, T: FloatArray, name: str, number: int) -> FloatArray | None:
        """Return the pose where `T` is in the rest `number`, at the angle with the most feasible grasps, if any."""
        xi = np.column_stack([np.tile(self._rest(T)[1][:2], (TURNS, 1)), np.arange(TURNS) * 2 * np.pi / TURNS])
        poses = [pose for pose in self._problem.rests.planar.at(number, xi) if self._can_rest(pose, name)]
        counts = [int(self._plans.feasible(pose).sum()) for pose in poses]
        return poses[int(np.argmax(counts))] if any(counts) else None

    # ---- changes of grasps and tool

    def _with_more_grasps(self, ends: Ends) -> None:
        problem, count, seed = self._problem, MORE * len(self._problem.grasps), self._seed + 1
        grasps = self._sampled(problem.workcell.arm.end_effector, count, seed)
        if grasps is None:
            return
        text, value = f"{len(grasps)} instead of {len(problem.grasps)}", {"grasps": count, "seed": seed}
        self._try(Change.GRASPS, text, value, ends, self._with(problem.workcell, grasps))

    def _sampled(self, tool: EndEffector, count: int, seed: int) -> GraspSet | None:
        clearance = self._problem.workcell.clearance.gripper
        try:
            return sample_grasps(self._problem.object, tool, count, seed=seed, clearance=clearance)
        except GraspError:
            return None

    def _with_other_tools(self, ends: Ends) -> None:
        cell = self._problem.workcell
        for name in END_EFFECTOR_NAMES:
            tool = load_end_effector(name)
            if self._late() or tool.fingerprint() == cell.arm.end_effector.fingerprint():
                continue
            value, other = {"end_effector": name}, replace(cell, arm=replace(cell.arm, end_effector=tool))
            hit, grasps = collision_at_home(other), self._sampled(tool, TOOL_GRASPS, 0)
            if hit is not None or grasps is None:
                outcome = f"'{hit[0]}' collides with '{hit[1]}' at home" if hit else "no grasp fits the object"
                self._fails(Change.TOOL, f"'{name}'", outcome, value)
            else:
                self._try(Change.TOOL, f"'{name}'", value, ends, self._with(other, grasps))

    def _too_wide(self, found: Explanation) -> tuple[Reason, ...]:
        """Return whether grasps that the jaw is too narrow for would be feasible where all others are in the table."""
        cell, tool = self._problem.workcell, self._problem.workcell.arm.end_effector
        if tool.kind != "parallel" or self._late():
            return ()
        widest = tool.max_opening - 2 * tool.pre_opening
        extent = float(np.linalg.norm(self._problem.object.mesh.extents))
        wider = replace(tool, max_opening=extent + 2 * tool.pre_opening)
        grasps = self._sampled(wider, MORE * TOOL_GRASPS, self._seed)
        if grasps is None or not (wide := np.flatnonzero(grasps.width > widest)).size:
            return ()
        grasps = grasps.subset(wide.tolist())
        checker = self._with(replace(cell, arm=replace(cell.arm, end_effector=wider)), grasps).checker
        table = Reason(Cause.GRIPPER_IN_TABLE)
        good = [checker.feasible(pose.T) for pose in found.poses if table in pose.causes]
        if not all(each.any() for each in good):
            return ()
        needed = max(float(grasps.width[each].min()) for each in good)
        text = f"'{tool.name}', which takes {1e3 * widest:.0f} mm: {1e3 * needed:.0f} mm would do"
        return (Reason(Cause.TOO_WIDE, (text,)),)
