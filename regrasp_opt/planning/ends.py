"""The start and goal poses that a caller gives: checks before anything is planned, and what is known of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from regrasp_opt.connectivity import BLOCKED, exact_energy
from regrasp_opt.conventions import BoolArray, FloatArray, as_pose
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.errors import PoseError
from regrasp_opt.feasibility.standing import nearest_board, rest_problem, support_of
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning.at_rest import EXACT, GivenPose, rest_within, within_tolerance
from regrasp_opt.planning.problem_data import ProblemData
from regrasp_opt.scene import Support, Workcell


def checked_end(T: Any, name: str, problem: ProblemData) -> FloatArray:
    """Return the pose `T` as a rigid (4, 4) transform at which the problem's object can rest in its workcell.

    Raises
    ------
    PoseError
        If it is not a rigid transform, floats above the table, sinks into it, stands over its edge, would tip over or
        roll, overlaps an obstacle or the robot's base, or lies outside the workspace or the arm's reach; `name` (start
        or goal) is in the message.
    """
    T = as_pose(T, f"{name} pose")
    _check_workspace(T, name, problem.object, problem.workcell)
    problem_at_rest = rest_problem(T, problem.object, problem.workcell)
    if problem_at_rest is not None:
        raise PoseError(f"the object {problem_at_rest} at the {name} pose; put it down in a stable placement")
    overlapped = problem.checker.object_overlaps(T, 0.0)
    if overlapped is not None:
        raise PoseError(f"the object overlaps {overlapped} at the {name} pose; move it away")
    return T


def resting_end(
    T: Any, name: str, problem: ProblemData, tolerance: tuple[float, float]
) -> tuple[FloatArray, GivenPose | None]:
    """Return the start or goal pose (4, 4) that `T` means, and what was given where that is another one.

    A pose at which the object can rest is taken as it is. Of any other the nearest resting pose within `tolerance`
    ([m], [rad]) is taken; x and y on a board stay as they are given.

    Raises
    ------
    PoseError
        If neither is possible; the message has the nearest resting pose, or both where two are possible.
    """
    try:
        return checked_end(T, name, problem), None
    except PoseError as error:
        T = as_pose(T, f"{name} pose")
        found = problem.nearest_rests(T)
        near = within_tolerance(found, tolerance)
        nearest = next(iter(near or found), None)
        if nearest is None or (
            nearest.motion <= EXACT and isinstance(problem.workcell.support(nearest.support), Support)
        ):
            raise
        if not near:
            raise PoseError(f"{error}; the nearest resting pose is {nearest.label}, {nearest.away} away") from error
    return checked_end(rest_within(found, tolerance, f"{name} pose").T, name, problem), GivenPose(T)


def known_energy(energy: GraspEnergy, T: FloatArray, feasible: BoolArray) -> FloatArray:
    """Return energies (G,) at the pose `T` (4, 4) where `feasible` (G,) is known exactly."""
    return exact_energy(feasible) if energy.model.bounded else np.where(feasible, energy(T), BLOCKED)


def _check_workspace(T: FloatArray, name: str, model: ObjectModel, workcell: Workcell) -> None:
    vertices = model.vertices @ T[:3, :3].T + T[:3, 3]
    number = support_of(T, model, workcell)
    support = nearest_board(T, model, workcell) if number is None else workcell.supports[number]
    if isinstance(support, Support):
        center = support.seen(T[:3, :3] @ model.center_of_mass + T[:3, 3])[:2]
        low, high = support.workspace.array
        if (center < low - 1e-9).any() or (center > high + 1e-9).any():
            where = "" if len(workcell.supports) == 1 else f" of the support '{support.name}'"
            raise PoseError(
                f"the {name} pose is outside the workspace{where}: the object's centre is at x = {center[0]:.3f}, "
                f"y = {center[1]:.3f} m; keep it in x [{low[0]:g}, {high[0]:g}], y [{low[1]:g}, {high[1]:g}]"
            )
    distance = float(np.linalg.norm(vertices - workcell.arm.T_world_base[:3, 3], axis=1).min())
    reach = workcell.arm.robot.max_reach + workcell.arm.end_effector.tcp_offset
    if distance > reach:
        raise PoseError(
            f"the {name} pose is out of reach: the object is {distance:.2f} m from the robot's base, "
            f"which reaches {reach:.2f} m; move it nearer"
        )
