"""A second proof of motions, from problem data and the numbers of the trajectories alone.

It shares no code with the planner: trajectories are evaluated by SciPy's Hermite splines, forward kinematics is a
product of joint transforms over whole batches, and each pair of bodies near each other gets its own Coal distance.
Samples are so dense that between two of them no corner of a body moves by more than `STEP` and none turns by more than
`TURN`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import coal
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.motion import MotionPlan, Phase, Segment
from regrasp_opt.shapes import Box, Cylinder, Shape

STEP = 1e-3
"""Largest motion of any corner of a body between samples [m]."""

TURN = np.deg2rad(0.2)
"""Largest turn of any body between samples [rad]."""

CONTINUITY = 1e-6
"""Largest jump between segments, and largest error of a pose at grasp and release [rad, m, rad/s]."""

TABLE_CONTACT = 1.1e-3
"""How far a held object may sink into the table where it is lifted or lowered [m]: as at rest, and 0.1 mm."""

JAW_CONTACT = 2e-3
"""Opening beyond the grasp's width from which on the fingers must be clear of the object [m]."""


class _Body(NamedTuple):
    name: str
    link: int  # number of the joint it moves with, 0 for the base and what stands in the world
    T: FloatArray  # in the frame of its link; in the base frame for link 0
    geometry: Any
    half: FloatArray  # of a box around it, centred at `center` in the body's frame
    center: FloatArray


@dataclass(frozen=True)
class Recheck:
    """What was found.

    Attributes
    ----------
    problems : tuple of str
        One sentence for each claim that does not hold.
    collisions : int
        Samples at which two bodies overlap that must not.
    least : float
        Least distance between any two bodies that must not touch, where it is below 10 mm [m].
    velocity, acceleration : float
        Largest share of a limit that was reached.
    samples : int
    """

    problems: tuple[str, ...]
    collisions: int
    least: float
    velocity: float
    acceleration: float
    samples: int


NEAR = 0.01
"""Boxes around bodies farther apart than this are not measured [m]."""


def recheck(motion: MotionPlan) -> Recheck:
    """Check every segment of a solved `motion` again."""
    return _Checker(motion).run()


class _Checker:
    def __init__(self, motion: MotionPlan) -> None:
        self.motion, self.problem = motion, motion.plan.problem
        self.problems: list[str] = []
        self.collisions, self.samples, self.least = 0, 0, NEAR
        self.velocity = self.acceleration = 0.0
        self.robot = self.problem.workcell.robot
        mesh = self.problem.object.mesh
        self.mesh = _bvh(np.array(mesh.vertices), np.array(mesh.faces))
        self.vertices = np.array(mesh.vertices)

    def run(self) -> Recheck:
        self._sequence()
        for segment in self.motion.segments:
            self._limits(segment)
            self._collisions(segment)
        return Recheck(
            tuple(self.problems), self.collisions, self.least, self.velocity, self.acceleration, self.samples
        )

    def _say(self, segment: Segment, text: str) -> None:
        self.problems.append(f"transition {segment.transition}, {segment.phase.name.lower()}: {text}")

    def _sequence(self) -> None:
        """Check the order of phases, that nothing jumps, and that grasps and poses are those of the plan."""
        motion, plan, cell = self.motion, self.motion.plan, self.problem.workcell
        expected = [Phase.APPROACH, Phase.GRASP, Phase.LIFT, Phase.TRANSFER, Phase.LOWER, Phase.RELEASE, Phase.RETREAT]
        for i in range(len(plan.transitions)):
            phases = [s.phase for s in motion.segments if s.transition == i]
            if [p for p in phases if p not in (Phase.REACH, Phase.RETURN)] != expected:
                self.problems.append(f"transition {i} has the phases {[p.name for p in phases]}")
            if len({s.grasp_id for s in motion.segments if s.transition == i}) > 1:
                self.problems.append(f"transition {i} changes the grasp on its way")
        for a, b in zip(motion.segments[:-1], motion.segments[1:], strict=True):
            if np.abs(a.trajectory.positions[-1] - b.trajectory.positions[0]).max() > CONTINUITY:
                self._say(b, "the arm jumps at the beginning")
            if np.abs(a.trajectory.velocities[-1] - b.trajectory.velocities[0]).max() > CONTINUITY:
                self._say(b, "the arm's speed jumps at the beginning")
            if abs(a.jaw[1] - b.jaw[0]) > CONTINUITY:
                self._say(b, "the jaw jumps at the beginning")
        for s, rows in self._resting():
            still = np.ptp(s.trajectory.positions[rows], axis=0).max() <= CONTINUITY
            if not still or np.abs(s.trajectory.velocities[rows]).max() > CONTINUITY:
                self._say(s, "the arm does not rest")
        for s in motion.segments:
            if s.grasp_id not in plan.transitions[s.transition].grasp_ids:
                self._say(s, "the grasp is not shared by the two poses")
            for phase, row, T in ((Phase.GRASP, 0, s.transition), (Phase.RELEASE, -1, s.transition + 1)):
                if s.phase is phase:
                    flange = self._frames(s.trajectory.positions[row][None])[0, -1]
                    tcp = cell.T_world_base @ flange @ _shift(cell.end_effector.tcp_offset)
                    wanted = plan.poses[T] @ self.problem.grasps.T_object_tcp[s.grasp_id]
                    if np.abs(tcp - wanted).max() > CONTINUITY:
                        self._say(s, f"the hand misses the grasp by {np.abs(tcp - wanted).max():.2g}")

    def _resting(self) -> list[tuple[Segment, slice]]:
        """Return where the arm must rest: segments, and their knots."""
        segments = self.motion.segments
        still = [(s, slice(None)) for s in segments if s.phase in (Phase.GRASP, Phase.RELEASE)]
        return [(segments[0], slice(0, 1)), (segments[-1], slice(-1, None)), *still]

    def _limits(self, segment: Segment) -> None:
        path, robot = segment.trajectory, self.robot
        curve = CubicHermiteSpline(path.times, path.positions, path.velocities)
        t = _dense(path.times)
        q, v, a = curve(t), curve(t, 1), curve(t, 2)
        if (q < robot.lower - 1e-9).any() or (q > robot.upper + 1e-9).any():
            self._say(segment, "a joint leaves its limits")
        for name, values, limit in (
            ("velocity", v, self.motion.velocity_limits),
            ("acceleration", a, self.motion.acceleration_limits),
        ):
            share = float((np.abs(values) / limit).max())
            setattr(self, name, max(getattr(self, name), share))
            if share > 1 + 1e-6:
                self._say(segment, f"the {name} is {share:.4f} of its limit")

    def _frames(self, q: FloatArray) -> FloatArray:
        """Return the poses (B, dof+2, 4, 4) of base, joints and flange in the base frame at `q` (B, dof)."""
        chain = self.robot.chain
        frames = [np.broadcast_to(np.eye(4), (len(q), 4, 4))]
        for j in range(chain.dof):
            x, y, z = chain.axes[j]
            motion = np.tile(np.eye(4), (len(q), 1, 1))
            if chain.prismatic[j]:
                motion[:, :3, 3] = q[:, j, None] * chain.axes[j]
            else:
                K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
                s, c = np.sin(q[:, j])[:, None, None], np.cos(q[:, j])[:, None, None]
                motion[:, :3, :3] += s * K + (1 - c) * (K @ K)
            frames.append(frames[-1] @ chain.placements[j] @ motion)
        frames.append(frames[-1] @ chain.tip)
        return np.stack(frames, axis=1)

    def _collisions(self, segment: Segment) -> None:
        bodies, pairs = self._arranged(segment)
        path = segment.trajectory
        curve = CubicHermiteSpline(path.times, path.positions, path.velocities)
        moving = [b for b in bodies if b.link > 0]
        t = _dense(path.times)
        while True:
            t, done = self._refined(t, curve, moving)
            if done:
                break
        q = curve(t)
        self.samples += len(t)
        frames = self._frames(q)
        T = np.stack([frames[:, b.link] @ b.T for b in bodies], axis=1)  # (B, bodies, 4, 4)
        half = np.einsum("bnij,nj->bni", np.abs(T[:, :, :3, :3]), np.array([b.half for b in bodies]))
        centers = np.einsum("bnij,nj->bni", T[:, :, :3, :3], np.array([b.center for b in bodies])) + T[:, :, :3, 3]
        low, high = centers - half, centers + half
        first, second = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
        gap = np.maximum(low[:, first] - high[:, second], low[:, second] - high[:, first]).max(axis=2)
        hit = np.zeros(len(t), dtype=bool)
        named: set[str] = set()
        for b, k in zip(*np.nonzero(gap < NEAR), strict=True):
            i, j, allowed = pairs[k]
            distance = _distance(bodies[i].geometry, T[b, i], bodies[j].geometry, T[b, j])
            self.least = min(self.least, distance if allowed == 0 else NEAR)
            if distance <= allowed:
                hit[b] = True
                named.add(f"{bodies[i].name} meets {bodies[j].name}")
        hit |= self._in_table(segment, frames, named)
        self.collisions += int(hit.sum())
        for text in sorted(named):
            self._say(segment, text)

    def _refined(self, t: FloatArray, curve: Any, moving: list[_Body]) -> tuple[FloatArray, bool]:
        """Return times between which nothing moves too far, and whether `t` were already such."""
        q = curve(t)
        frames = self._frames(q)
        corners = np.concatenate(
            [
                (frames[:, b.link] @ b.T @ np.concatenate([_corners(b), np.ones((1, 8))]))[:, :3].swapaxes(1, 2)
                for b in moving
            ],
            axis=1,
        )
        move = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(axis=1) / STEP
        turn = np.abs(np.diff(q, axis=0))[:, ~self.robot.chain.prismatic].sum(axis=1) / TURN
        parts = np.maximum(1, np.ceil(np.maximum(move, turn))).astype(int)
        if (parts == 1).all():
            return t, True
        pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(t[:-1], t[1:], parts, strict=True)]
        return np.concatenate([*pieces, t[-1:]]), False

    def _in_table(self, segment: Segment, frames: FloatArray, named: set[str]) -> BoolArray:
        """Return where (B,) the held object sinks into the table while it is lifted or lowered."""
        deep = np.zeros(len(frames), dtype=bool)
        if segment.phase in (Phase.LIFT, Phase.LOWER):
            cell = self.problem.workcell
            T = cell.T_world_base @ frames[:, -1] @ self._T_flange_object(segment)
            lowest = (T[:, 2, :3] @ self.vertices.T).min(axis=1) + T[:, 2, 3]
            deep = lowest < cell.table.height - TABLE_CONTACT
            if deep.any():
                named.add("the object sinks into the table")
        return deep

    def _T_flange_object(self, segment: Segment) -> FloatArray:
        T_object_tcp = self.problem.grasps.T_object_tcp[segment.grasp_id]
        inverse: FloatArray = _shift(self.problem.workcell.end_effector.tcp_offset) @ np.linalg.inv(T_object_tcp)
        return inverse

    def _arranged(self, segment: Segment) -> tuple[list[_Body], list[tuple[int, int, float]]]:
        """Return the bodies of a segment, and which pairs (i, j) must be more than so far apart [m]."""
        cell, robot, flange = self.problem.workcell, self.robot, self.robot.dof + 1
        arm = [
            _body(f"{robot.link_of(n)}", item.parentJoint, np.array(item.placement.homogeneous), item.geometry)
            for n, item in enumerate(robot.collision.geometryObjects)
        ]
        palm = [_body(f"gripper {s.name}", flange, s.pose, _solid(s)) for s in cell.end_effector.body]
        fingers, touching = self._fingers(segment, flange)
        world = np.linalg.inv(cell.T_world_base)
        fixed = [_body(s.name, 0, world @ s.pose, _solid(s)) for s in (cell.table.shape, *cell.obstacles)]
        held = segment.phase.holds
        if held:
            thing = _body("object", flange, self._T_flange_object(segment), self.mesh)
        else:
            past = segment.phase in (Phase.RELEASE, Phase.RETREAT, Phase.RETURN)
            pose = self.motion.plan.poses[segment.transition + past]
            thing = _body("object", 0, world @ pose, self.mesh)
        bodies = [*arm, *palm, *fingers, *touching, *fixed, thing]
        number = {id(b): n for n, b in enumerate(bodies)}
        chosen = self._pairs(segment, arm, [*palm, *fingers], touching, fixed, thing)
        return bodies, [(number[id(a)], number[id(b)], 0.0) for a, b in chosen]

    def _pairs(
        self,
        segment: Segment,
        arm: list[_Body],
        gripper: list[_Body],
        touching: list[_Body],
        fixed: list[_Body],
        thing: _Body,
    ) -> Iterator[tuple[_Body, _Body]]:
        held, dof = segment.phase.holds, self.robot.dof
        ignored = self.robot.ignored
        for n, a in enumerate(arm):
            for b in arm[n + 1 :]:
                if abs(a.link - b.link) > 1 and frozenset((a.name, b.name)) not in ignored:
                    yield a, b
            if a.link < dof:
                yield from ((a, g) for g in (*gripper, *touching))
            if a.link > 0:
                yield from ((a, f) for f in fixed)
            if a.link > 0 or held:
                yield a, thing
        for g in (*gripper, *touching):
            yield from ((g, f) for f in fixed)
        if not held:
            yield from ((g, thing) for g in gripper)
        resting = segment.phase in (Phase.LIFT, Phase.LOWER)
        if held:
            yield from ((thing, f) for f in (fixed[1:] if resting else fixed))

    def _fingers(self, segment: Segment, flange: int) -> tuple[list[_Body], list[_Body]]:
        """Return fingers that must be clear of the object, and those that may touch it.

        While the arm rests and the jaw moves, they stand at every millimetre; else at both ends' openings.
        """
        effector = self.problem.workcell.end_effector
        width = float(self.problem.grasps.width[segment.grasp_id])
        a, b = segment.jaw
        count = max(2, int(np.ceil(abs(b - a) / 1e-3)) + 1)
        clear, touching = list[_Body](), list[_Body]()
        for opening in np.unique(np.linspace(a, b, count)):
            for box in effector.finger:
                for side in (1.0, -1.0):
                    T = box.pose.copy()
                    T[1, 3] = side * (T[1, 3] + opening / 2)
                    part = _body(f"finger {box.name}", flange, T, coal.Box(*map(float, box.size)))
                    free = opening >= width + min(JAW_CONTACT, 2 * effector.pre_opening) - 1e-9
                    (clear if free and not segment.phase.holds else touching).append(part)
        return clear, touching


def _dense(times: FloatArray) -> FloatArray:
    """Return `times` with nine more in each interval."""
    return np.unique(np.concatenate([np.linspace(a, b, 11) for a, b in itertools.pairwise(times)]))


def _shift(z: float) -> FloatArray:
    T = np.eye(4)
    T[2, 3] = z
    return T


def _corners(body: _Body) -> FloatArray:
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1)
    corners: FloatArray = body.center[:, None] + signs * body.half[:, None]
    return corners


def _body(name: str, link: int, T: FloatArray, geometry: Any) -> _Body:
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    low, high = np.array(box.min_), np.array(box.max_)
    return _Body(name, int(link), T, geometry, (high - low) / 2, (high + low) / 2)


def _solid(shape: Shape) -> Any:
    if isinstance(shape, Box):
        return coal.Box(*(float(s) for s in shape.size))
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.length)
    return _bvh(shape.vertices, shape.faces)


def _bvh(vertices: FloatArray, faces: Any) -> Any:
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addVertices(np.asarray(vertices, dtype=np.float64))
    model.addTriangles(np.asarray(faces, dtype=np.int64))
    model.endModel()
    return model


def _distance(a: Any, T_a: FloatArray, b: Any, T_b: FloatArray) -> float:
    first, second = coal.Transform3s(T_a[:3, :3], T_a[:3, 3]), coal.Transform3s(T_b[:3, :3], T_b[:3, 3])
    return float(coal.distance(a, first, b, second, coal.DistanceRequest(), coal.DistanceResult()))
