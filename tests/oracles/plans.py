"""Every claim of a solved plan, verified from its file and the files that it names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from .contacts import hold_problem
from .files import Board, Cell, read_cell, read_object
from .world import World

TOLERANCE = 1e-4
"""How far a distance may fall short of what is required [m]."""
MISS = 2e-6
"""Largest entry of the difference between two poses that should be one [m or 1]."""
LIMIT = 1e-9
"""How far a joint may be beyond its limit [rad]."""
DENT = 1e-3
"""How deep a closed finger may be in the object [m]: its pad gives way."""
RESTS = 1e-3
"""How far start and goal may be from resting, and what else touches the board [m]."""
RESTS_EXACTLY = 1e-5
"""The same of intermediate poses, which the planner has computed."""
HELD = 1e-6
"""Largest entry of the difference between the object's pose and that in which a nest holds it [m or 1]."""
NEST = 1e-3
"""How deep an object may be in the bodies of the nest that it is in [m]."""


class PlanVerifier:
    """Verifies plans of one object in one cell.

    Parameters
    ----------
    content : dict
        A plan file, for the object and cell that it names; None where `cell`, `mesh` and the object's `name` are given.
    tolerance : float
        How far a distance may fall short of what is required [m].
    """

    def __init__(self, content, cell: Cell | None = None, mesh=None, tolerance=TOLERANCE, name=None):
        self.tolerance = tolerance
        self.name = name or (content and content["object"]["name"])
        self.cell = cell or read_cell(content["workcell"])
        self.world = World(self.cell, *(mesh or read_object(content["object"])))
        self.solid = self.world.object_solid
        given = (content or {}).get("object", {}).get("mass_properties", {})
        self.center_of_mass = np.array(given.get("center_of_mass", self.solid.center_of_mass))
        self.test(self._required_pairs())
        self._held: dict[tuple, str | None] = {}

    def test(self, pairs):
        """Test these `pairs` of bodies from now on: (body, body, least distance, whether it counts as clearance)."""
        self.pairs = list(pairs)
        self._columns = tuple(np.array(column) for column in zip(*self.pairs, strict=True))

    # ---- plans

    def problems(self, content, rows=None):
        """Return one sentence for each claim of a solved plan that does not hold.

        Parameters
        ----------
        rows : callable, optional
            From the number of grasps of a transition to those rows of it that are looked at; by default all.
        """
        if content["status"] != "solved":
            return [f"the plan's status is {content['status']}"]
        poses, transitions = np.array(content["poses"]), content["transitions"]
        wrong = []
        named = [None, *content.get("supports", [None] * (len(poses) - 2)), None]
        if len(named) != len(poses):
            return [f"{len(named) - 2} supports are named for {len(poses)} poses"]
        for i, T in enumerate(poses):
            exact = 0 < i < len(poses) - 1
            wrong += [f"pose {i}: {text}" for text in self.pose_problems(T, exact, named[i])]
        if len(transitions) != len(poses) - 1:
            wrong.append(f"there are {len(transitions)} transitions between {len(poses)} poses")
        for i, transition in enumerate(transitions[: len(poses) - 1]):
            ids = transition["grasp_ids"]
            if not ids:
                wrong.append(f"transition {i} has no grasp")
            for k in rows(len(ids)) if rows else range(len(ids)):
                grasp, claim = content["grasps"][ids[k]], transition["clearance"][k]
                T_grasp, width = np.array(grasp["T_object_tcp"]), grasp["width"]
                sides = ("pick", poses[i], transition["q_pick"][k]), ("place", poses[i + 1], transition["q_place"][k])
                found = [self.hold_problem(T_grasp, width)]
                for side, T, q in sides:
                    found += [f"{side}: {text}" for text in self.grasp_problems(q, T, T_grasp, width, claim)]
                wrong += [f"transition {i}, grasp {ids[k]}: {text}" for text in found if text]
        return wrong

    def hold_problem(self, T_object_tcp, width):
        """Return why a grasp (4, 4) with the jaw `width` [m] open does not hold the object, or None."""
        key = (T_object_tcp.tobytes(), width)
        if key not in self._held:
            self._held[key] = self._sunk(T_object_tcp, width) or hold_problem(
                self.cell.tool, self.solid, T_object_tcp, width
            )
        return self._held[key]

    def _sunk(self, T_object_tcp, width):
        """Return whether a finger is deep in the object where the jaw is `width` [m] open."""
        world, tool = self.world, self.cell.tool
        T_object_tip = T_object_tcp.copy()
        T_object_tip[:3, 3] -= tool.tcp_offset * T_object_tcp[:3, 2]
        world.put("object", np.eye(4))
        fingers = world.put_fingers(T_object_tip, width + 2 * min(DENT, tool.pre_opening))
        if any(world.distance(n, world.index["object"], TOLERANCE) < -TOLERANCE for n in fingers):
            return f"at a width of {width:.4f} m a finger is in the object"
        return None

    def pose_problems(self, T, exact=False, name=None):
        """Return what keeps the object from resting at `T` (4, 4) on a support, the one called `name` if that is given.

        Intermediate poses must rest `exact`ly, as the planner has computed them.
        """
        wrong = []
        if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > MISS or np.linalg.det(T[:3, :3]) < 0:
            wrong.append("it is not a rigid pose")
        on, problems = self.support_at(T, exact, name)
        if on is None:
            return [*wrong, f"there is no support '{name}'"]
        return wrong + problems + self._object_problems(T, on)

    def support_at(self, T, exact=False, name=None):
        """Return the number of the support on which the object is at `T` (4, 4), or nearly is, and what is wrong.

        What holds the object counts before a board that it touches.
        """
        found = [
            (*self._resting(T, support, exact), n)
            for n, support in enumerate(self.cell.supports)
            if name in (None, support.name)
        ]
        if not found:
            return None, []
        wrong, _, number = min(found, key=lambda o: (len(o[0]) > 0, isinstance(self.cell.supports[o[2]], Board), o[1]))
        return number, wrong

    def _resting(self, T, support, exact):
        """Return what keeps the object at `T` (4, 4) from resting on a support, and how far it is off [m or 1]."""
        if not isinstance(support, Board):
            held = [np.abs(T - pose).max() for pose, only in support.poses if only in (None, self.name)]
            off = min(held, default=np.inf)
            return ([f"it is {off:.2g} off what {support.name} holds"] if not off <= HELD else []), off
        tolerance, wrong = RESTS_EXACTLY if exact else RESTS, []
        points = support.seen(self.solid.vertices @ T[:3, :3].T + T[:3, 3])
        center = support.seen(T[:3, :3] @ self.center_of_mass + T[:3, 3])
        gap = points[:, 2].min()
        if abs(gap) > tolerance + MISS:
            wrong.append(f"it is {gap:.2g} m above the {support.name}")
        feet = points[points[:, 2] <= max(gap + MISS, tolerance), :2]
        beyond = (np.abs(feet - support.center) > np.array(support.size) / 2 + MISS).any(axis=1)
        if beyond.any():
            wrong.append(f"it stands over the edge of the {support.name}")
        down = -support.T[2, :3]  # gravity in the frame of the board
        if not _in_hull(center[:2] - center[2] / down[2] * down[:2], feet):
            wrong.append("it would tip over")
        if np.linalg.norm(down[:2]) > -down[2] * support.friction + MISS:
            wrong.append(f"it would slide off the {support.name}")
        for value, axis in zip(center, "xy", strict=False):
            if not support.space[axis][0] - MISS <= value <= support.space[axis][1] + MISS:
                wrong.append(f"its centre of mass is outside the workspace in {axis}")
        return wrong, abs(gap) + (10.0 if beyond.all() else 0.0)

    def _object_problems(self, T, on):
        """Return which bodies the object at `T` (4, 4), on the support of this number, is too near to."""
        self.world.place(np.zeros(self.world.dof), T, 0.0, 0.0)
        thing, near, wrong = self.world.index["object"], self.cell.clearance["gripper"], []
        for n, body in enumerate(self.world.bodies):
            if body.part in ("obstacle", "fixed") or (body.part == "arm" and body.group == 0):
                wrong += self._apart(thing, n, near)
            elif body.part == "support" and not self._above(T, body.support, on):
                wrong += self._apart(thing, n, -NEST if body.support == on else near)
        return wrong

    def _above(self, T, number, on):
        """Return whether the object at `T` (4, 4) is on the board of this `number`, or wholly above its plane."""
        board = self.cell.supports[number]
        if not isinstance(board, Board):
            return False
        return number == on or board.seen(self.solid.vertices @ T[:3, :3].T + T[:3, 3])[:, 2].min() >= -RESTS - MISS

    # ---- configurations

    def grasp_problems(self, q, T, T_object_tcp, width, claim=-np.inf):
        """Return what is wrong with holding the object at `T` (4, 4) at configuration `q` (dof,).

        Parameters
        ----------
        claim : float
            What the distance of arm and gripper to what is around them is said to be at least [m].
        """
        q, limits = np.array(q, dtype=float), self.cell.robot.limits
        if q.shape != (self.world.dof,):
            return [f"there are {len(q)} joint positions for {self.world.dof} joints"]
        wrong = []
        if (q < limits[:, 0] - LIMIT).any() or (q > limits[:, 1] + LIMIT).any():
            wrong.append("a joint is beyond its limit")
        miss = np.abs(self._place(q, T, width) - T @ T_object_tcp).max()
        if not miss <= MISS:
            wrong.append(f"the arm misses the grasp by {miss:.2g}")
        return wrong + self._collisions(claim)

    def collisions(self, q, T, width, all_of_them=True):
        """Return which bodies are too near at configuration `q` (dof,) with the object at `T` (4, 4)."""
        self._place(q, T, width)
        return self._collisions(-np.inf, all_of_them)

    def clearance(self, q, T, width):
        """Return the least distance [m] of arm and gripper to supports, obstacles and (arm alone) object, and where."""
        self._place(q, T, width)
        outer = [(self.world.distance(a, b, 10.0), a, b) for a, b, _, outer in self.pairs if outer]
        least, a, b = min(outer)
        return least, {self.world.bodies[a].part, self.world.bodies[b].part}

    def _place(self, q, T, width):
        tool = self.cell.tool
        T_world_tip = self.world.place(np.asarray(q, dtype=float), T, width, width + 2 * tool.pre_opening)
        T_world_tip[:3, 3] += tool.tcp_offset * T_world_tip[:3, 2]
        return T_world_tip

    def _collisions(self, claim, all_of_them=True):
        wrong, centers, radii = [], self.world.centers(), self.world.radii()
        first, second, least, outer = self._columns
        least = least.copy()
        least[outer] = np.maximum(least[outer], claim)
        gaps = np.linalg.norm(centers[first] - centers[second], axis=1) - radii[first] - radii[second]
        for k in np.flatnonzero(gaps <= least):
            if all_of_them or not wrong:
                wrong += self._apart(first[k], second[k], least[k])
        return wrong

    def _apart(self, a, b, least):
        found = self.world.distance(a, b, max(least, 0.0) + TOLERANCE, least - self.tolerance)
        if found >= least - self.tolerance:
            return []
        first, second = (self.world.bodies[n].name for n in (a, b))
        return [f"{first} and {second} are {found:.5f} m apart, not {least:.5f} m"]

    def _required_pairs(self):
        """Return (body, body, least distance, whether it counts as clearance) for all that must not touch."""
        near, robot = self.cell.clearance, self.cell.robot
        bodies, pairs = self.world.bodies, []
        last = robot.group[robot.tip]

        def pair(a, b):
            """Return (least distance, whether it is part of the clearance) for two bodies, or None."""
            kinds = {a.part, b.part}
            arm, other = (a, b) if a.part == "arm" else (b, a)
            moving = arm.part == "arm" and arm.group > 0
            if a.part == b.part == "arm":
                touching = {*self.cell.ignored, *robot.joined}
                apart = a.group != b.group and frozenset((a.link, b.link)) not in touching
                return (near["self_collision"], False) if apart else None
            if other.part in ("support", "obstacle", "fixed", "object") and moving:
                ignored = other.part == "fixed" and frozenset((a.link, b.link)) in self.cell.ignored
                return None if ignored else (near["arm"], True)
            hand = {"palm", "finger"} & kinds
            if hand and kinds & {"support", "obstacle", "fixed"}:
                return near["gripper"], True
            if hand and "arm" in kinds:
                return (near["self_collision"], False) if arm.group != last else None
            if kinds & {"palm", "open"} and "object" in kinds:
                return 0.0, False
            if "object" in kinds and (kinds & {"obstacle", "fixed"} or "arm" in kinds):
                return near["gripper"], False
            return None

        for i, a in enumerate(bodies):
            for j in range(i):
                found = pair(a, bodies[j])
                if found is not None:
                    pairs.append((i, j, *found))
        return pairs


def _in_hull(point, points):
    try:
        equations = ConvexHull(points).equations if len(points) > 2 else None
    except QhullError:
        return False
    return equations is not None and bool((equations[:, :2] @ point + equations[:, 2] <= MISS).all())


def verify_plan(path):
    """Return what is wrong with the plan in the file `path`, one sentence each."""
    content = json.loads(Path(path).read_text("utf-8"))
    return PlanVerifier(content).problems(content)
