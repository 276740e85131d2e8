"""Every claim of a solved motion, verified from its file and the files that it names.

Trajectories are evaluated by SciPy's Hermite splines, at times so dense that between two of them no corner of a body
moves by more than `STEP`, none turns by more than `TURN`, and the jaw opens or closes by less than `STEP`. A pair of
bodies is not measured again until they could have come near each other.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from .plans import LIMIT, TOLERANCE, PlanVerifier

STEP = 1e-3
"""Largest motion of any corner of a body between samples [m]."""
TURN = np.deg2rad(0.2)
"""Largest turn of any body between samples [rad]."""
CONTINUITY = 1e-6
"""Largest jump between segments [rad, m, rad/s]."""
MISS = 2e-6
"""Largest entry of the difference between two poses that should be one [m or 1]."""
CONTACT = 1.1e-3
"""How far a held object may sink into the support that it leaves, or is put on [m]: as at rest, and 0.1 mm."""
JAW_CONTACT = 2e-3
"""Opening beyond the grasp's width from which on the fingers must be clear of the object [m]."""
BETWEEN = 0.5
"""Share of each clearance that is kept between the times at which it was tested (docs/motion.md)."""
JUMP = 0.01
"""Largest jump of an acceleration, as a share of its limit."""
FAR = 0.02
"""Distances of meshes that are not convex are measured up to this [m]."""

PHASES = ["approach", "grasp", "lift", "transfer", "lower", "release", "retreat"]
HOLDS = "lift", "transfer", "lower"
STILL = "grasp", "release"
AFTER = "release", "retreat", "return"


@dataclass(frozen=True)
class MotionFindings:
    """What was found: problems, samples at which bodies were too near, and the largest shares of the limits.

    `jump` is the largest jump of an acceleration at a knot, at a rest or between segments, as a share of its limit.
    """

    problems: list[str]
    collisions: int = 0
    samples: int = 0
    velocity: float = 0.0
    acceleration: float = 0.0
    jerk: float = 0.0
    jump: float = 0.0


class MotionVerifier:
    """Verifies motions of one object in one cell; see `PlanVerifier` for what it is made from."""

    def __init__(self, content, plans: PlanVerifier | None = None):
        self.plans = plans or PlanVerifier(content["plan"])
        self.world, self.cell = self.plans.world, self.plans.cell
        self._pairs = self._required_pairs()

    def verify(self, content, step=STEP, turn=TURN):
        """Return what was found out about a solved motion; its plan is another matter (`PlanVerifier.problems`)."""
        segments = content["segments"]
        if content["status"] != "solved" or not segments:
            return MotionFindings([f"the motion's status is {content['status']}"])
        if content["joint_names"] != self.cell.robot.joints:
            return MotionFindings(["the motion is one of other joints"])
        curves = [_Curve(segment) for segment in segments]
        problems = self._sequence(content, segments, curves)
        jump = largest_jump(content)
        if content["schema"] > 1:
            problems += _jaw_problems(content, segments, curves)
            problems += [f"an acceleration jumps by {jump:.4f} of its limit"] if jump > JUMP else []
        collisions = samples = 0
        velocity = acceleration = jerk = 0.0
        for segment, curve in zip(segments, curves, strict=True):
            named, shares = self._limits(content, curve)
            grasp = content["plan"]["grasps"][segment["grasp_id"]]
            found, hit, count = self._collisions(content, segment, curve, grasp, step, turn)
            named += found
            velocity, acceleration = max(velocity, shares[0]), max(acceleration, shares[1])
            jerk = max(jerk, *shares[2:], 0.0)
            collisions, samples = collisions + hit, samples + count
            problems += [f"transition {segment['transition']}, {segment['phase']}: {text}" for text in named]
        return MotionFindings(problems, collisions, samples, velocity, acceleration, jerk, jump)

    def _sequence(self, content, segments, curves):
        """Return what is wrong with the order of phases, and with what must be equal at their ends."""
        plan, wrong = content["plan"], []
        for i, transition in enumerate(plan["transitions"]):
            mine = [s for s in segments if s["transition"] == i]
            if [s["phase"] for s in mine if s["phase"] not in ("reach", "return")] != PHASES:
                wrong.append(f"transition {i} has the phases {[s['phase'] for s in mine]}")
            if len({s["grasp_id"] for s in mine}) > 1:
                wrong.append(f"transition {i} changes the grasp on its way")
            if any(s["grasp_id"] not in transition["grasp_ids"] for s in mine):
                wrong.append(f"transition {i}: the grasp is not shared by the two poses")
        for (s, a), (t, b) in pairwise(zip(segments, curves, strict=True)):
            name = f"transition {t['transition']}, {t['phase']}"
            for what, end, start in (
                ("arm jumps", a.positions[-1], b.positions[0]),
                ("arm's speed jumps", a.velocities[-1], b.velocities[0]),
                ("jaw jumps", s["jaw"][1], t["jaw"][0]),
            ):
                if np.abs(np.asarray(end) - start).max() > CONTINUITY:
                    wrong.append(f"{name}: the {what} at the beginning")
            if t["transition"] not in (s["transition"], s["transition"] + 1):
                wrong.append(f"{name}: it follows transition {s['transition']}")
        return wrong + self._stillness(segments, curves) + self._ends(plan, segments, curves)

    def _stillness(self, segments, curves):
        still = [(0, slice(0, 1)), (-1, slice(-1, None))]
        still += [(n, slice(None)) for n, s in enumerate(segments) if s["phase"] in STILL]
        wrong = []
        for n, rows in still:
            moves = np.ptp(curves[n].positions[rows], axis=0).max() > CONTINUITY
            if moves or np.abs(curves[n].velocities[rows]).max() > CONTINUITY:
                name = f"transition {segments[n]['transition']}, {segments[n]['phase']}"
                wrong.append(f"{name}: the arm does not rest")
        return wrong

    def _ends(self, plan, segments, curves):
        """Return where the hand is not at the grasp, or the jaw not at its width, when it closes or opens."""
        wrong, poses = [], np.array(plan["poses"])
        for s, curve in zip(segments, curves, strict=True):
            name = f"transition {s['transition']}, {s['phase']}"
            grasp = plan["grasps"][s["grasp_id"]]
            closed = grasp["width"] if self.cell.tool.kind == "parallel" else 0.0
            if s["phase"] in STILL:
                row, pose = (0, s["transition"]) if s["phase"] == "grasp" else (-1, s["transition"] + 1)
                tcp = self._tcp(curve.positions[row])
                miss = np.abs(tcp - poses[pose] @ np.array(grasp["T_object_tcp"])).max()
                if miss > MISS:
                    wrong.append(f"{name}: the hand misses the grasp by {miss:.2g}")
                if abs(s["jaw"][1 if s["phase"] == "grasp" else 0] - closed) > CONTINUITY:
                    wrong.append(f"{name}: the jaw does not close to the grasp's width")
            if s["phase"] in HOLDS and np.abs(np.array(s["jaw"]) - closed).max() > CONTINUITY:
                wrong.append(f"{name}: the jaw moves while it holds")
            if self.cell.tool.kind == "parallel" and not 0 <= min(s["jaw"]) <= max(s["jaw"]) <= self._most():
                wrong.append(f"{name}: the jaw opens too far")
        return wrong

    def _most(self):
        return self.cell.tool.max_opening + CONTINUITY

    def _tcp(self, q):
        T = self.world.place(q, None, 0.0, 0.0)
        T[:3, 3] += self.cell.tool.tcp_offset * T[:3, 2]
        return T

    def _limits(self, content, curve):
        robot, wrong, shares = self.cell.robot, [], []
        t = curve.dense()
        q, v, a = curve.at(t), curve.at(t, 1), curve.at(t, 2)
        if (q < robot.limits[:, 0] - LIMIT).any() or (q > robot.limits[:, 1] + LIMIT).any():
            wrong.append("a joint leaves its limits")
        speeds = np.minimum(content["velocity_limits"], robot.speeds)
        limited = [("velocity", v, speeds), ("acceleration", a, content["acceleration_limits"])]
        if content.get("jerk_limits"):
            limited.append(("jerk", curve.at(t, 3), content["jerk_limits"]))
        for name, values, limit in limited:
            shares.append(float((np.abs(values) / limit).max()))
            if shares[-1] > 1 + (1e-3 if name == "jerk" else 1e-6):  # a third derivative of rounded positions
                wrong.append(f"the {name} is {shares[-1]:.4f} of its limit")
        return wrong, shares

    # ---- collisions

    def _required_pairs(self):
        """Return (body, body, least distance) for all that is ever tested."""
        return [(a, b, required) for a, b, required, _ in self.plans.pairs]

    def _collisions(self, content, segment, curve, grasp, step, turn):
        """Return what comes too near, at how many samples, and how many samples there were."""
        world, width = self.world, grasp["width"]
        t, poses = self._sampled(content, segment, curve, grasp, step, turn)
        xpos, xmat = poses
        opening = curve.jaw(t)
        moved = np.concatenate([[0.0], np.cumsum(self._moves(xpos, xmat))])
        hit, named = np.zeros(len(t), dtype=bool), {}
        clear = min(JAW_CONTACT, 2 * self.cell.tool.pre_opening)
        for a, b, required in self._chosen(content, segment):
            closing = {world.bodies[a].part, world.bodies[b].part} == {"object", "open"}
            i = 0
            while i < len(t):
                if closing and opening[i] < width + clear - 1e-9:
                    i += 1
                    continue
                apart = self._distance(a, b, xpos[i], xmat[i], max(required, 0) + FAR) - (
                    BETWEEN * required if required > 0 else required
                )
                if apart < -TOLERANCE:
                    hit[i] = True
                    meets = "meets" if required >= 0 else "sinks into"
                    named[f"{world.bodies[a].name} {meets} {world.bodies[b].name}"] = None
                    i += 1
                else:
                    i = max(i + 1, int(np.searchsorted(moved, moved[i] + (apart + TOLERANCE) / 2)))
        return sorted(named), int(hit.sum()), len(t)

    def _distance(self, a, b, xpos, xmat, most):
        world = self.world
        for n in (a, b):
            geom = world.bodies[n].geom
            world.data.geom_xpos[geom], world.data.geom_xmat[geom] = xpos[n], xmat[n]
        return world.distance(a, b, most)

    def _chosen(self, content, segment):
        """Return the pairs (a, b, least distance) that matter in a phase; below 0: how deep they may touch."""
        bodies, last = self.world.bodies, self.cell.robot.group[self.cell.robot.tip]
        held, phase = segment["phase"] in HOLDS, segment["phase"]
        for a, b, required in self._pairs:
            kinds = {bodies[a].part, bodies[b].part}
            if "object" in kinds:
                other = bodies[b] if bodies[a].part == "object" else bodies[a]
                hand = other.part in ("palm", "open")
                if hand and (held or (phase in STILL and other.part == "palm")):
                    continue
                if not held and not hand and not (other.part == "arm" and other.group > 0):
                    continue  # both stand still, as in the plan
                if held and other.part == "arm" and other.group == last:
                    continue  # moves with it
            yield a, b, required
        if not held:
            return
        plan, leaves = content["plan"], segment["transition"] + (phase == "lower")
        own = None if phase == "transfer" else self.plans.support_at(np.array(plan["poses"][leaves]))[0]
        for n, body in enumerate(bodies):
            if body.part == "support":
                yield self.world.index["object"], n, -CONTACT if body.support == own else self.cell.clearance["gripper"]

    def _sampled(self, content, segment, curve, grasp, step, turn):
        """Return dense times, and poses of all bodies there."""
        t = np.unique(np.concatenate([curve.dense(), np.linspace(0, curve.duration, curve.jaw_steps(step))]))
        while True:
            poses = self._poses(content, segment, curve, grasp, t)
            move = self._moves(*poses) / step
            parts = np.maximum(1, np.ceil(np.maximum(move, self._turns(poses[1]) / turn) - 1e-6)).astype(int)
            if (parts == 1).all():
                return t, poses
            pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(t[:-1], t[1:], parts, strict=True)]
            t = np.concatenate([*pieces, t[-1:]])

    def _poses(self, content, segment, curve, grasp, t):
        """Return positions (B, bodies, 3) and rotations (B, bodies, 9) at times `t` (B,)."""
        world, geoms = self.world, self.world.geoms
        held, plan_poses = segment["phase"] in HOLDS, content["plan"]["poses"]
        T_tcp_object = np.linalg.inv(grasp["T_object_tcp"])
        there = np.array(plan_poses[segment["transition"] + (segment["phase"] in AFTER)])
        xpos, xmat = np.empty((len(t), len(geoms), 3)), np.empty((len(t), len(geoms), 9))
        for n, (q, opening) in enumerate(zip(curve.at(t), curve.jaw(t), strict=True)):
            T = world.place(q, None, opening, opening)
            T[:3, 3] += self.cell.tool.tcp_offset * T[:3, 2]
            world.put("object", T @ T_tcp_object if held else there)
            xpos[n], xmat[n] = world.data.geom_xpos[geoms], world.data.geom_xmat[geoms]
        return xpos, xmat

    def _moves(self, xpos, xmat):
        """Return how far any corner of a body moves at most in each interval [m]."""
        model, geoms = self.world.model, self.world.geoms
        signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        corners = model.geom_aabb[geoms, None, :3] + signs * model.geom_aabb[geoms, None, 3:]
        far = np.zeros(len(xpos) - 1)
        for first in range(0, len(far), 500):
            rows = slice(first, first + 501)
            R = xmat[rows].reshape(*xmat[rows].shape[:2], 3, 3)
            points = xpos[rows][:, :, None] + np.einsum("bgij,gcj->bgci", R, corners)
            step = np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=(1, 2))
            far[first : first + len(step)] = step
        return far

    def _turns(self, xmat):
        R = xmat.reshape(*xmat.shape[:2], 3, 3)
        cosine = (np.einsum("bgij,bgij->bg", R[1:], R[:-1]) - 1) / 2
        return np.arccos(np.clip(cosine.min(axis=1), -1, 1))


def largest_jump(content):
    """Return the largest jump of an acceleration in a motion that begins and ends at rest, as a share of its limit."""
    curves, limits = map(_Curve, content["segments"]), np.array(content["acceleration_limits"])
    rest = np.zeros((1, len(limits)))
    first, last = zip(*(curve.end_accelerations() for curve in curves), strict=True)
    jumps = np.concatenate([*first, rest]) - np.concatenate([rest, *last])
    return float((np.abs(jumps) / limits).max())


def _jaw_problems(content, segments, curves):
    """Return where the commands to the jaw are not those that the segments need."""
    squeeze, began, wrong = content["squeeze"], 0.0, []
    needed = [(0.0, 0.0, *[segments[0]["jaw"][0]] * 3, None, False)]
    for s, curve in zip(segments, curves, strict=True):
        first, last = s["jaw"]
        command = max(0.0, last - squeeze["below_contact"]) if s["phase"] == "grasp" else last
        force = squeeze["force"] if s["phase"] == "grasp" else None
        if s["phase"] in STILL or first != last:
            needed.append((began, curve.duration, first, last, command, force, s["phase"] == "grasp"))
        began += curve.duration
    keys = "time", "duration", "width_from", "width_to", "command", "force", "holds"
    told = [tuple(event[key] for key in keys) for event in content["jaw_events"]]
    if len(told) != len(needed):
        return [f"the jaw is told {len(told)} things, not {len(needed)}"]
    for n, (event, right) in enumerate(zip(told, needed, strict=True)):
        if event[5:] != right[5:] or np.abs(np.subtract(event[:5], right[:5])).max() > CONTINUITY:
            wrong.append(f"jaw event {n} is {event}, not {right}")
    return wrong


class _Curve:
    """The joints and the jaw of a segment over time."""

    def __init__(self, segment):
        self.times, self.positions, self.velocities = (
            np.array(segment[key], dtype=float) for key in ("times", "positions", "velocities")
        )
        self._spline = CubicHermiteSpline(self.times, self.positions, self.velocities)
        self._jaw = segment["jaw"]
        self.duration = float(self.times[-1])

    def at(self, t, derivative=0):
        return self._spline(t, derivative)

    def dense(self):
        return np.unique(np.concatenate([np.linspace(a, b, 11) for a, b in pairwise(self.times)]))

    def end_accelerations(self):
        """Return accelerations at the beginning and at the end of each piece, two arrays (pieces, dof)."""
        cubic, square = self._spline.c[:2]
        return 2 * square, 2 * square + 6 * cubic * np.diff(self.times)[:, None]

    def jaw(self, t):
        return np.interp(t, [0.0, self.duration], self._jaw)

    def jaw_steps(self, step):
        return max(2, int(np.ceil(abs(self._jaw[1] - self._jaw[0]) / step)) + 1)


def verify_motion(path):
    """Return what is wrong with the motion in the file `path` and with its plan, one sentence each."""
    content = json.loads(Path(path).read_text("utf-8"))
    plans = PlanVerifier(content["plan"])
    return plans.problems(content["plan"]) + MotionVerifier(content, plans).verify(content).problems
