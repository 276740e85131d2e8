"""The certificate of a plan: its claims recomputed from problem data, by other means than the planner's.

Forward kinematics come from Pinocchio's own algorithm on the robot's URDF model, distances from one `coal.distance`
call for each pair of bodies, with the fingers where they stand at the grasp width and at the width they approach
with. The planner uses inverse kinematics, swept fingers and batched collision tests instead. Every claimed grasp is
tested on the object (`regrasp_opt.grasps.holding`). Which bodies there are, which of them may touch, and the
clearances of all others come from the same `CollisionWorld`. A plan's cost is a record and is not recomputed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import (
    CLEARANCE_TOLERANCE,
    FK_POSITION_TOLERANCE,
    FK_ROTATION_TOLERANCE,
    JOINT_LIMIT_TOLERANCE,
    PLACEMENT_TOLERANCE,
    RESTING_TOLERANCE,
    FloatArray,
    pose_distance,
)
from regrasp_opt.geometry.shapes import shape_geometry
from regrasp_opt.geometry.solids import Solid, distance, separation
from regrasp_opt.grasps import hold_failures
from regrasp_opt.objects import ObjectModel
from regrasp_opt.objects.symmetry import is_symmetry
from regrasp_opt.planning.plan_data import PlanData, Transition
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.planning.rests import NEST_OVERLAP
from regrasp_opt.scene import Fixture, Support, Workcell
from regrasp_opt.scene.collision_world import CollisionWorld, ContactPhase


@dataclass(frozen=True)
class TransitionResiduals:
    """What was recomputed for the K grasps of one transition; columns are pick and place.

    Attributes
    ----------
    position_error, rotation_error : (K, 2)
        Distance [m] and angle [rad] between the TCP of forward kinematics and of pose times grasp.
    limit_margin : (K, 2)
        Least distance of a joint from its limits [rad]; negative outside.
    collision_margin : (K, 2)
        Least (distance - required clearance) over all pairs of bodies [m]; negative if a plan's claim is false.
    clearance_error : (K,)
        How far the claimed clearance exceeds the recomputed one [m]; negative where the claim was modest.
    nearest : tuple of pairs of str
        The two bodies with the least margin, for pick and place of each grasp in turn.
    failures : tuple of str or None
        Why each grasp does not hold the object; None where it does.
    """

    position_error: FloatArray
    rotation_error: FloatArray
    limit_margin: FloatArray
    collision_margin: FloatArray
    clearance_error: FloatArray
    nearest: tuple[tuple[str, str], ...]
    failures: tuple[str | None, ...]


@dataclass(frozen=True)
class Residuals:
    """The certificate of a plan, recomputed.

    Attributes
    ----------
    transitions : tuple of TransitionResiduals
    placement_error : (N,)
        Distance of each intermediate pose from its stable placement moved by its planar parameters [m or rad].
    problems : tuple of str
        One sentence for each claim that does not hold; empty if the plan is verified.
    """

    transitions: tuple[TransitionResiduals, ...]
    placement_error: FloatArray
    problems: tuple[str, ...]

    @property
    def hold(self) -> bool:
        """Whether every claim of the plan was confirmed."""
        return not self.problems


def compute_residuals(plan: PlanData) -> Residuals:
    """Recompute every claim of `plan`; see `RegraspPlan.residuals`."""
    scene = _Scene(plan.problem)
    problems: list[str] = []
    if plan.solved and len(plan.transitions) != len(plan.poses) - 1:
        problems.append(f"the plan has {len(plan.poses)} poses but {len(plan.transitions)} transitions")
    problems += _rest_violations(plan) + _edge_violations(plan) + _turn_violations(plan)
    placement_error = _placement_errors(plan, problems)
    transitions = []
    for i, transition in enumerate(plan.transitions):
        ends = plan.poses[i : i + 2]
        residuals = _transition(scene, transition, ends)
        transitions.append(residuals)
        problems += [f"transition {i}: {text}" for text in _violations(transition, residuals)]
    return Residuals(tuple(transitions), placement_error, tuple(problems))


def _rest_violations(plan: PlanData) -> list[str]:
    """Return what keeps the object from resting on a support at the poses, inside the workspace."""
    body, texts, last = plan.problem.object, [], len(plan.poses) - 1
    for i, T in enumerate(plan.poses):
        name = {0: "the start", last: "the goal"}.get(i, f"pose {i}")
        support, points = _support(plan, i)
        if isinstance(support, Fixture):
            continue
        lowest = float(points[:, 2].min())
        if abs(lowest) > RESTING_TOLERANCE + PLACEMENT_TOLERANCE:
            texts.append(f"the object does not touch the {support.name} at {name}: {lowest:.2g} m off")
        middle = np.append(T[:3, :3] @ body.center_of_mass + T[:3, 3], 1.0)
        center = (np.linalg.inv(support.T_world_support) @ middle)[:3]
        low, high = support.workspace.array
        outside = (center[:2] < low - PLACEMENT_TOLERANCE).any() or (center[:2] > high + PLACEMENT_TOLERANCE).any()
        if outside and i in (0, last):  # xi of the others is tested
            texts.append(f"{name} lies outside the workspace")
        touching = points[points[:, 2] <= RESTING_TOLERANCE + PLACEMENT_TOLERANCE, :2]
        up = support.T_world_support[2, :3]
        if len(touching) and _leans_out(touching - (center[:2] - center[2] / up[2] * up[:2])):
            texts.append(f"the object would tip over at {name}")
        elif body.rolls(np.linalg.inv(support.T_world_support) @ T):
            texts.append(f"the object would roll at {name}")
    return texts


def _support(plan: PlanData, i: int) -> tuple[Support | Fixture, FloatArray]:
    """Return the support of pose `i`, and the object's vertices (V, 3) seen there.

    Intermediate poses name it; at the ends it is looked for.
    """
    body, rests, T = plan.problem.object, plan.problem.rests, plan.poses[i]
    if 0 < i < len(plan.poses) - 1 and 0 <= plan.placements[i - 1] < len(rests):
        support = rests[plan.placements[i - 1]].support
        inverse = np.linalg.inv(support.T_world_support) @ T
        return support, body.vertices @ inverse[:3, :3].T + inverse[:3, 3]
    return _below(T, body, plan.problem.workcell)


def _below(T: FloatArray, body: ObjectModel, cell: Workcell) -> tuple[Support | Fixture, FloatArray]:
    """Return the support that the object at `T` (4, 4) is in or on, or nearest to, and its vertices (V, 3) seen there.

    It is on a board that its lowest points touch somewhere within the edges.
    """
    world, found = body.vertices @ T[:3, :3].T + T[:3, 3], list[tuple[bool, float, int, FloatArray]]()
    for number, support in enumerate(cell.supports):
        inverse = np.linalg.inv(support.T_world_support)
        points = world @ inverse[:3, :3].T + inverse[:3, 3]
        if isinstance(support, Fixture):
            held = any(
                max(map(float, pose_distance(support.T_world_support @ p.T_support_object, T))) <= PLACEMENT_TOLERANCE
                for p in support.poses
                if p.object in (None, body.name)
            )
            if held:
                return support, points
            continue
        lowest = float(points[:, 2].min())
        near = points[points[:, 2] <= lowest + RESTING_TOLERANCE, :2]
        aside = not (np.abs(near - support.center) <= support.size / 2 + PLACEMENT_TOLERANCE).all(axis=1).any()
        found.append((aside, abs(lowest), number, points))
    *_, number, points = min(found, key=lambda each: each[:3])
    return cell.supports[number], points


def _turn_violations(plan: PlanData) -> list[str]:
    """Return which ends are turned in a way that is not a symmetry of the object."""
    ends = zip(("start", "goal"), plan.given, strict=True)
    turned = {name: end.turn for name, end in ends if end is not None and end.turn is not None}
    wrong = [name for name, turn in turned.items() if not is_symmetry(plan.problem.object, turn)]
    return [f"the {name} is turned in a way that is not a symmetry of the object" for name in wrong]


def _leans_out(points: FloatArray) -> bool:
    """Return whether all `points` (S, 2) lie on one side of a line through the origin, by more than rounding."""
    angles = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    return bool(gaps.max() > np.pi + 1e-6)


def _edge_violations(plan: PlanData) -> list[str]:
    """Return at which poses the object touches its support beyond the edges, or is too near to another support.

    It touches with its lowest points, and with all that are as near to the board as resting may be. Rounding is given
    in favour of the plan.
    """
    body, cell, texts = plan.problem.object, plan.problem.workcell, []
    shapes = [[(Solid(shape_geometry(s)), s.pose) for s in support.shapes] for support in cell.supports]
    for i, T in enumerate(plan.poses):
        support, points = _support(plan, i)
        if isinstance(support, Support):
            lowest, near = points[:, 2].min(), RESTING_TOLERANCE
            touching = points[points[:, 2] <= max(lowest + PLACEMENT_TOLERANCE, near - PLACEMENT_TOLERANCE), :2]
            if (np.abs(touching - support.center) > support.size / 2 + PLACEMENT_TOLERANCE).any():
                texts.append(f"the object stands over the edge of the {support.name} at pose {i}")
        for other, solids in zip(cell.supports, shapes, strict=True):
            if isinstance(other, Support) and (other is support or _clears(other, T, body)):
                continue
            required = -NEST_OVERLAP if other is support else cell.clearance.gripper
            least = min((separation(body.solid, solid, T, pose) for solid, pose in solids), default=np.inf)
            if least < required - CLEARANCE_TOLERANCE:
                texts.append(f"the object is {least:.2g} m from the {other.name} at pose {i}")
    return texts


def _clears(board: Support, T: FloatArray, body: ObjectModel) -> bool:
    """Return whether the object at `T` (4, 4) is wholly above the plane of a board."""
    up = board.T_world_support[:3, 2]
    lowest = ((body.vertices @ T[:3, :3].T + T[:3, 3] - board.T_world_support[:3, 3]) @ up).min()
    return bool(lowest >= -RESTING_TOLERANCE - PLACEMENT_TOLERANCE)


def _placement_errors(plan: PlanData, problems: list[str]) -> FloatArray:
    """Return how far intermediate poses are from stable placements inside the workspace; append what is wrong."""
    errors, rests = [], plan.problem.rests
    for i, (T, m, xi) in enumerate(zip(plan.poses[1:-1], plan.placements, plan.xi, strict=True), start=1):
        if not 0 <= m < len(rests):
            problems.append(f"pose {i} names placement {m}, which does not exist")
            errors.append(np.inf)
            continue
        c, s = np.cos(xi[2]), np.sin(xi[2])
        planar = np.array([[c, -s, 0, xi[0]], [s, c, 0, xi[1]], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        wanted = rests.planar.surfaces[m] @ planar @ rests.planar.bases[m]
        error = max(float(e) for e in pose_distance(wanted, T))
        errors.append(error)
        if error > PLACEMENT_TOLERANCE:
            problems.append(f"pose {i} is {error:.2g} away from stable placement {rests[m].label}")
        low, high = rests.planar.low[m], rests.planar.high[m]
        if (xi < low - PLACEMENT_TOLERANCE).any() or (xi > high + PLACEMENT_TOLERANCE).any():
            problems.append(f"pose {i} lies outside the workspace")
    return np.array(errors)


def _transition(scene: _Scene, transition: Transition, ends: FloatArray) -> TransitionResiduals:
    robot, grasps = scene.problem.workcell.arm.robot, scene.problem.grasps
    count = len(transition.grasp_ids)
    position, rotation, limit, collision, clearance = (np.zeros((count, 2)) for _ in range(5))
    nearest = []
    for k, grasp_id in enumerate(transition.grasp_ids.tolist()):
        for side, (T, q) in enumerate(zip(ends, (transition.q_pick[k], transition.q_place[k]), strict=True)):
            wanted = T @ grasps.T_object_tcp[grasp_id]
            position[k, side], rotation[k, side] = pose_distance(scene.tcp(q), wanted)
            limit[k, side] = min((q - robot.lower).min(), (robot.upper - q).min())
            collision[k, side], clearance[k, side], pair = scene.margins(q, T, grasp_id)
            nearest.append(pair)
    excess = transition.clearance - clearance.min(axis=1)
    held = hold_failures(
        grasps.subset(transition.grasp_ids), scene.problem.object, scene.problem.workcell.arm.end_effector
    )
    failures = tuple(None if failure is None else failure.value for failure in held)
    return TransitionResiduals(position, rotation, limit, collision, excess, tuple(nearest), failures)


def _violations(transition: Transition, residuals: TransitionResiduals) -> list[str]:
    texts = []
    if len(transition.grasp_ids) == 0:
        texts.append("no grasp is shared by its two poses")
    for grasp_id, failure in zip(transition.grasp_ids.tolist(), residuals.failures, strict=True):
        texts += [] if failure is None else [f"grasp {grasp_id} does not hold the object: {failure}"]
    checks = (
        ("the arm misses the grasp by {:.2g} m", residuals.position_error, FK_POSITION_TOLERANCE, 1),
        ("the arm misses the grasp by {:.2g} rad", residuals.rotation_error, FK_ROTATION_TOLERANCE, 1),
        ("a joint is {:.2g} rad beyond its limit", residuals.limit_margin, JOINT_LIMIT_TOLERANCE, -1),
        (
            "bodies are {:.2g} m nearer than their clearance",
            residuals.collision_margin,
            CLEARANCE_TOLERANCE,
            -1,
        ),
    )
    for text, values, tolerance, sign in checks:
        for k, side in zip(*np.nonzero(~(sign * values <= tolerance)), strict=True):
            which = f"grasp {transition.grasp_ids[k]} at its {('pick', 'place')[side]}"
            detail = f" ({' and '.join(residuals.nearest[2 * k + side])})" if "bodies" in text else ""
            texts.append(f"{which}: {text.format(sign * values[k, side])}{detail}")
    for k in np.flatnonzero(~(residuals.clearance_error <= CLEARANCE_TOLERANCE)):
        claim = f"claims {residuals.clearance_error[k]:.2g} m more clearance than it has"
        texts.append(f"grasp {transition.grasp_ids[k]}: {claim}")
    return texts


class _Scene:
    """The bodies of a problem, placed and measured by other means than the planner's."""

    def __init__(self, problem: RegraspProblem) -> None:
        self.problem, self.arm = problem, problem.workcell.arm
        self.world = world = CollisionWorld(problem.workcell, problem.object)
        self.data = self.arm.robot.model.createData()
        self.solids = [Solid(body.geometry) for body in world.bodies]
        closed = [pair for pair in world.pairs(ContactPhase.GRASP) if pair[0] in world.fingers]
        opened = [*world.pairs(ContactPhase.MOVE), *world.pairs(ContactPhase.REST)]
        self.pairs = [(*pair, False) for pair in closed] + [(*pair, True) for pair in opened]
        arm, gripper = (*world.moving, *world.gripper), world.gripper
        self.measured = np.array(
            [
                i in arm and j in world.surroundings and not (i in gripper and j == world.object)
                for i, j, *_ in self.pairs
            ]
        )

    def margins(self, q: FloatArray, T: FloatArray, grasp_id: int) -> tuple[float, float, tuple[str, str]]:
        """Return the least (distance - required clearance) [m], the distance to the surroundings [m], and the pair.

        The arm is at `q` (dof,), the object at `T` (4, 4), the fingers at the grasp width and where they approach.
        """
        bodies, width = self.world.bodies, float(self.problem.grasps.width[grasp_id])
        widths = width, width + 2 * self.arm.end_effector.pre_opening
        closed, opened = (self._placed(q, T, w) for w in widths)
        distances = []
        for i, j, _, is_open in self.pairs:
            placed = opened if is_open else closed
            distances.append(distance(self.solids[i], self.solids[j], placed[i], placed[j]))
        margins = np.array(distances) - [required for _, _, required, _ in self.pairs]
        i, j, *_ = self.pairs[int(np.argmin(margins))]
        return float(margins.min()), float(np.array(distances)[self.measured].min()), (bodies[i].name, bodies[j].name)

    def tcp(self, q: FloatArray) -> FloatArray:
        """Return the TCP (4, 4) in the world at configuration `q` (dof,), by Pinocchio."""
        robot = self.arm.robot
        pin.framesForwardKinematics(robot.model, self.data, q)
        T_base_tip = self.data.oMf[robot.model.getFrameId(robot.tip_frame)].homogeneous
        return self.arm.T_world_base @ T_base_tip @ self.arm.end_effector.T_flange_tcp

    def _placed(self, q: FloatArray, T: FloatArray, width: float) -> list[FloatArray]:
        """Return where all bodies are in the world (4, 4)."""
        pin.forwardKinematics(self.arm.robot.model, self.data, q)
        poses = dict(zip(self.world.fingers, self.world.finger_poses(width), strict=True)) | {self.world.object: T}
        placed = [poses.get(i, body.pose) for i, body in enumerate(self.world.bodies)]
        for i in (*self.world.moving, *self.world.gripper):
            T_base_joint = self.data.oMi[self.world.bodies[i].joint].homogeneous
            placed[i] = self.arm.T_world_base @ T_base_joint @ placed[i]
        return placed
