"""What there is to see of a plan: parts, where they are at each step, the shared grasps, and the cost over the table.

The page draws a `PlanScene`. A step is a pick or a place, or a moment of a motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from plotly.colors import get_colorscale, hex_to_rgb
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray, IntArray, translation
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.scene import Workcell
from regrasp_opt.viz.candidates import CandidateTrace
from regrasp_opt.viz.causes import GraspCauses, grasp_causes
from regrasp_opt.viz.fields import CostField, cost_field, grasp_energies, has_energy
from regrasp_opt.viz.looks import BASE, COLOURS, Part, body_poses, grasp_mark, gripper_parts, robot_parts
from regrasp_opt.viz.surfaces import Patch, shape_surface
from regrasp_opt.viz.track import Track

SCALE = tuple(colour for _, colour in get_colorscale("Viridis"))
"""Colours from the least to the greatest energy or cost; they differ in lightness, so nobody needs to see hues."""


class Step(NamedTuple):
    """A position of the slider: its label, the transition that it belongs to, and the row of the scene's states.

    `pose` is the number of the plan's pose that the object rests at, -1 if it moves.
    """

    label: str
    transition: int
    state: int
    pose: int = -1


class Stop(NamedTuple):
    """A station on the slider: its name, that of its support, and the steps between which the object rests there."""

    name: str
    support: str
    first: int
    last: int


class SharedGrasps(NamedTuple):
    """The K shared grasps of one transition.

    Attributes
    ----------
    ids : (K,) int
    energies : (K,)
        Summed over both poses; NaN where there is no energy yet.
    clearance : (K,) [m]
    colours : (K, 3) uint8
        By energy, or by clearance where there is none.
    best : int
        Which of them the steps show first: the clearest, or the one that the motion uses.
    first_state : int
        Row of the states in which the first of them picks; the next row is its place, then comes the next grasp.
    """

    ids: IntArray
    energies: FloatArray
    clearance: FloatArray
    colours: IntArray
    best: int
    first_state: int


@dataclass(frozen=True, eq=False)
class PlanScene:
    """Everything that is drawn.

    Attributes
    ----------
    title, subtitle : str
    parts : tuple of Part
        Those that stand still are in the world frame.
    ghosts : tuple of (name, colour, pose (7,))
        The object at the plan's poses.
    object_surface, mark : Patch
        The object in its own frame, and what marks a grasp in the TCP frame.
    states : (M, bodies, 7)
        Poses of the moving bodies: position [m] and quaternion (x, y, z, w).
    steps : tuple of Step
    stops : tuple of Stop
        Where the plan has the object, in order, as far as the steps get there.
    seconds : float or None
        How long the steps take if they are a motion.
    grasps : tuple of SharedGrasps
    marks : (G, 7)
        Poses of all grasps in the object frame.
    fields : tuple of CostField
    table_height : float
    eye, target : (3,)
        Where to look from, and at what [m].
    candidates : CandidateTrace or None
        Candidates of a refiner by iteration.
    causes : tuple of GraspCauses
        Why grasps fail at each pose of the plan.
    """

    title: str
    subtitle: str
    parts: tuple[Part, ...]
    ghosts: tuple[tuple[str, str, FloatArray], ...]
    object_surface: Patch
    mark: Patch
    states: FloatArray
    steps: tuple[Step, ...]
    stops: tuple[Stop, ...]
    seconds: float | None
    grasps: tuple[SharedGrasps, ...]
    marks: FloatArray
    fields: tuple[CostField, ...]
    table_height: float
    eye: FloatArray
    target: FloatArray
    candidates: CandidateTrace | None = None
    causes: tuple[GraspCauses, ...] = ()


def plan_scene(plan: RegraspPlan, track: Track | None = None, candidates: CandidateTrace | None = None) -> PlanScene:
    """Return what there is to see of `plan`, with the moments of `track` as steps where one is given."""
    problem, cell = plan.problem, plan.problem.workcell
    parts = _parts(problem.object, cell)
    states, steps, grasps = _picks_and_places(plan)
    if track is not None:
        moved = track.labels, track.transitions, range(len(states), len(states) + len(track.times)), track.poses
        steps = [Step(*row) for row in zip(*moved, strict=True)]
        used = dict(zip(track.transitions, track.grasp_ids, strict=True))
        for i, grasp_id in used.items():
            grasps[i] = grasps[i]._replace(best=grasps[i].ids.tolist().index(grasp_id))
        states = np.concatenate([states, _states(plan, track.q, track.jaw, track.T_world_object)])
    names = ["start", *(f"pose {i}" for i in range(1, plan.num_regrasps + 1)), "goal"]
    colours = [COLOURS.get(name, COLOURS["intermediate"]) for name in names]
    rests = [[k for k, step in enumerate(steps) if step.pose == i] for i in range(len(names))]
    supports = [station.support or "" for station in plan.stations]
    eye, target = _view(plan.poses, cell)
    return PlanScene(
        title=f"{problem.object.name} in {cell.name}",
        subtitle=_subtitle(plan, track),
        parts=tuple(parts),
        ghosts=tuple(zip(names, colours, pose7(plan.poses), strict=True)),
        object_surface=parts[-1].surface,
        mark=grasp_mark(cell.arm.end_effector).creased(),
        states=states,
        steps=tuple(steps),
        stops=tuple(Stop(name, on, at[0], at[-1]) for name, on, at in zip(names, supports, rests, strict=True) if at),
        seconds=None if track is None else float(track.times[-1]),
        grasps=tuple(grasps),
        marks=pose7(problem.grasps.T_object_tcp),
        fields=tuple(cost_field(plan, i + 1) for i in range(plan.num_regrasps if has_energy(plan) else 0)),
        table_height=cell.table.height,
        eye=eye,
        target=target,
        candidates=candidates,
        causes=grasp_causes(plan) if track is None else (),
    )


def problem_scene(model: ObjectModel, cell: Workcell) -> PlanScene:
    """Return the arm of `cell` at home and `model` in its placements, in a row over the workspace."""
    count = len(model.placements)
    low, high = cell.bounds.array
    at = low + (np.arange(count) + 0.5)[:, None] / max(count, 1) * np.array([1.0, 0.0]) * (high - low)
    at[:, 1] = (low[1] + high[1]) / 2
    lift = [translation(x, y, cell.table.height) for x, y in at]
    poses = np.array([T @ p.pose for T, p in zip(lift, model.placements, strict=True)]).reshape(-1, 4, 4)
    states = _at_rest(cell, poses)
    x, y = (low + high) / 2
    eye, target = _view(poses if count else translation(x, y, cell.table.height)[None], cell)
    parts = _parts(model, cell)
    return PlanScene(
        title=f"{model.name} in {cell.name}",
        subtitle=f"the arm at home, {count} placement(s)",
        parts=tuple(parts),
        ghosts=tuple((f"placement {i}", COLOURS["intermediate"], pose) for i, pose in enumerate(pose7(poses))),
        object_surface=parts[-1].surface,
        mark=grasp_mark(cell.arm.end_effector).creased(),
        states=states,
        steps=tuple(Step(f"placement {i}" if count else "home", -1, i) for i in range(len(states))),
        stops=(),
        seconds=None,
        grasps=(),
        marks=np.zeros((0, 7)),
        fields=(),
        table_height=cell.table.height,
        eye=eye,
        target=target,
    )


def _parts(model: ObjectModel, cell: Workcell) -> list[Part]:
    dof = cell.arm.robot.dof
    parts = [
        *(Part(s.name, shape_surface(s), COLOURS["table"], BASE) for each in cell.supports for s in each.shapes),
        *(Part(s.name, shape_surface(s), COLOURS["obstacle"], BASE) for s in cell.obstacles),
        *robot_parts(cell.arm.robot, cell.arm.T_world_base),
        *gripper_parts(cell.arm.end_effector, dof),
        Part("object", Patch(model.vertices, model.faces), COLOURS["object"], dof + 3),
    ]
    return [part._replace(surface=part.surface.creased()) for part in parts]


def _view(poses: FloatArray, cell: Workcell) -> tuple[FloatArray, FloatArray]:
    """Return where to look from and at what (3,) [m] to see objects at `poses` (N, 4, 4) and the arm."""
    target = 0.6 * poses[:, :3, 3].mean(axis=0) + 0.4 * cell.arm.T_world_base[:3, 3] + np.array([0.0, 0.0, 0.14])
    away = target[:2] - cell.arm.T_world_base[:2, 3]
    away = away / np.linalg.norm(away) if np.linalg.norm(away) > 1e-3 else np.array([0.0, 1.0])
    return target + np.array([*(1.3 * away + 0.5 * np.array([away[1], -away[0]])), 0.75]), target


def _subtitle(plan: RegraspPlan, track: Track | None) -> str:
    if not plan.solved:
        return plan.message
    cost = "" if np.isnan(plan.cost) else f", connectivity cost J_seq {plan.cost:.2f}"
    duration = "" if track is None else f", motion of {track.times[-1]:.1f} s"
    return "; ".join([f"{plan.num_regrasps} regrasp(s){cost}{duration}", *plan.remarks])


def _picks_and_places(plan: RegraspPlan) -> tuple[FloatArray, list[Step], list[SharedGrasps]]:
    """Return the states in which every shared grasp picks and places, the steps of the clearest, and the grasps."""
    dof, width = plan.problem.workcell.arm.robot.dof, plan.problem.grasps.width
    if not plan.transitions:
        names = ["start", *(f"pose {i}" for i in range(1, plan.num_regrasps + 1)), "goal"]
        return _at_rest(plan.problem.workcell, plan.poses), [Step(n, -1, i, i) for i, n in enumerate(names)], []
    energies = grasp_energies(plan) if has_energy(plan) else None
    states, steps, grasps, row = [], [], [], 0
    for i, t in enumerate(plan.transitions):
        count, best = len(t.grasp_ids), int(t.clearance.argmax())
        q = np.stack([t.q_pick, t.q_place], axis=1).reshape(-1, dof)
        states.append(_states(plan, q, np.repeat(width[t.grasp_ids], 2), np.tile(plan.poses[i : i + 2], (count, 1, 1))))
        energy = np.full(count, np.nan) if energies is None else energies[i]
        colours = scaled_colours(-t.clearance if energies is None else energy)
        grasps.append(SharedGrasps(t.grasp_ids, energy, t.clearance, colours, best, row))
        steps += [Step(f"move {i}: {what}", i, row + 2 * best + k, i + k) for k, what in enumerate(("pick", "place"))]
        row += 2 * count
    return np.concatenate(states), steps, grasps


def scaled_colours(values: FloatArray, ends: tuple[float, float] | None = None) -> IntArray:
    """Return colours (..., 3) uint8 of `values` (...) between `ends`, or from their least to their 90th percentile."""
    low, high = ends or (float(values.min()), float(np.percentile(values, 90)))
    part = (values - low) / max(high - low, 1e-9)
    table = np.array([hex_to_rgb(colour) for colour in SCALE])
    at = np.linspace(0.0, 1.0, len(table))
    return np.stack([np.interp(part, at, channel) for channel in table.T], axis=-1).round().astype(np.uint8)


def _at_rest(cell: Workcell, T_world_object: FloatArray) -> FloatArray:
    """Return the states of the arm at home with the object at each pose (N, 4, 4), at the origin without one."""
    T = T_world_object if len(T_world_object) else np.eye(4)[None]
    home = np.tile(cell.arm.robot.home, (len(T), 1))
    bodies = body_poses(cell.arm.robot, cell.arm.T_world_base, home, np.zeros(len(T)))
    return pose7(np.concatenate([bodies, T[:, None]], axis=1))


def _states(plan: RegraspPlan, q: FloatArray, jaw: FloatArray, T_world_object: FloatArray) -> FloatArray:
    cell = plan.problem.workcell
    bodies = body_poses(cell.arm.robot, cell.arm.T_world_base, q, jaw)
    poses: FloatArray = pose7(np.concatenate([bodies, T_world_object[:, None]], axis=1))
    return poses


def pose7(T: FloatArray) -> FloatArray:
    """Return positions and quaternions (..., 7) of transforms (..., 4, 4)."""
    turned = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(*T.shape[:-2], 4)
    return np.concatenate([T[..., :3, 3], turned], axis=-1)
