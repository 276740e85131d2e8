"""Plans as JSON (docs/plan-file.md): versioned, written atomically, read back with every field checked."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import Field

from regrasp_opt.conventions import IntArray, as_pose
from regrasp_opt.errors import OptionError, PlanFileError, PoseError
from regrasp_opt.files import atomic_path
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import load_object
from regrasp_opt.objects.mass import NOTHING_GIVEN, MassProperties
from regrasp_opt.planning.at_rest import GivenPose
from regrasp_opt.planning.model_store import find_model
from regrasp_opt.planning.plan_data import PlanData, Status, Transition
from regrasp_opt.planning.problem import RegraspProblem, assemble
from regrasp_opt.scene import Workcell, load_workcell
from regrasp_opt.scene.record import (
    Reference,
    SceneRecord,
    absolute,
    added_fingerprint,
    reference,
    scene_changes,
    scene_content,
)
from regrasp_opt.schemas import Section, read_json, validated

SCHEMA = 3
NAMED = 3
"""Changes of a workcell that a message names."""

Row = list[float]
Planar = Annotated[list[float], Field(min_length=3, max_length=3)]
Number = Annotated[int, Field(ge=0, lt=2**31)]


Plan = TypeVar("Plan", bound=PlanData)


class _Object(Reference):
    scale: float = 1.0
    repair: bool = False
    thickness: float | None = None
    mass_properties: MassProperties = NOTHING_GIVEN


class _Workcell(SceneRecord):
    source: str
    name: str
    end_effector: str | None


class _Workcell1(Reference):
    end_effector: str | None = None


class _Grasp(Section):
    T_object_tcp: list[Row]
    width: Annotated[float, Field(ge=0)]
    name: str | None = None


class _Transition(Section):
    grasp_ids: list[Number]
    q_pick: list[Row]
    q_place: list[Row]
    clearance: list[float]


class _Given(Section):
    pose: list[Row]
    turn: Planar | None = None


class _Ends(Section):
    start: _Given | None = None
    goal: _Given | None = None


class _File(Section):
    schema_: int = Field(alias="schema")
    status: str
    num_regrasps: int
    cost: float | None
    poses: list[list[Row]]
    given: _Ends = _Ends()
    transitions: list[_Transition]
    timings: dict[str, float]
    placements: list[Number]
    supports: list[str]
    xi: list[Planar]
    seed: int
    refiner_stats: list[dict[str, Any]]
    object: _Object
    workcell: _Workcell
    grasps: Annotated[list[_Grasp], Field(min_length=1)]


class _File2(_File):
    supports: list[str] | None = None  # type: ignore[assignment]


class _File1(_File2):
    workcell: _Workcell1  # type: ignore[assignment]


_SCHEMAS: dict[int, type[_File]] = {1: _File1, 2: _File2, SCHEMA: _File}


def plan_summary(plan: PlanData) -> dict[str, Any]:
    """Return the keys that ``--json`` prints: status, num_regrasps, cost, poses, transitions and timings."""
    return {
        "status": plan.status.name.lower(),
        "num_regrasps": plan.num_regrasps,
        "cost": plan.cost if math.isfinite(plan.cost) else None,
        "poses": plan.poses.tolist(),
        "transitions": [
            {name: getattr(t, name).tolist() for name in ("grasp_ids", "q_pick", "q_place", "clearance")}
            for t in plan.transitions
        ],
        "timings": plan.timings,
    }


def save_plan(plan: PlanData, path: str | os.PathLike[str]) -> None:
    """Write `plan` to `path`; the file holds the grasps and names the object and workcell it was made for."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(plan_content(plan), allow_nan=False) + "\n", encoding="utf-8")


def plan_content(plan: PlanData) -> dict[str, Any]:
    """Return what the file of `plan` holds."""
    problem = plan.problem
    body, cell = problem.object, problem.workcell
    return {
        "schema": SCHEMA,
        **plan_summary(plan),
        **_given_content(plan),
        "placements": [problem.rests[m].placement for m in plan.placements],
        "supports": [problem.rests[m].support.name for m in plan.placements],
        "xi": plan.xi.tolist(),
        "seed": plan.seed,
        "refiner_stats": plan.refiner_stats,
        "object": reference(body, body.source)
        | {"scale": body.scale, "repair": body.repair, "thickness": body.thickness}
        | ({"mass_properties": body.given.given()} if body.given.given() else {}),
        "workcell": {
            "source": absolute(cell.source),
            "name": cell.name,
            "end_effector": cell.end_effector_override,
            **scene_content(cell),
        },
        "grasps": _grasp_content(problem.grasps),
    }


def _grasp_content(grasps: GraspSet) -> list[dict[str, Any]]:
    items = zip(grasps.T_object_tcp, grasps.width, strict=True)
    content = [{"T_object_tcp": T.tolist(), "width": float(width)} for T, width in items]
    for grasp, name in zip(content, grasps.names, strict=False):
        grasp["name"] = name
    return content


def _given_content(plan: PlanData) -> dict[str, Any]:
    """Return what start and goal were given as; nothing, where that is what the plan has."""
    ends = zip(("start", "goal"), plan.given, strict=True)
    given = {
        name: {"pose": end.T.tolist(), "turn": None if end.turn is None else end.turn.tolist()}
        for name, end in ends
        if end is not None
    }
    return {"given": given} if given else {}


def _given(record: _Given | None, name: str) -> GivenPose | None:
    if record is None:
        return None
    return GivenPose(as_pose(record.pose, f"given {name}"), None if record.turn is None else np.array(record.turn))


def load_plan(path: str | os.PathLike[str], kind: type[Plan]) -> Plan:
    """Read a plan of class `kind`; see `RegraspPlan.load`."""
    return plan_from_content(read_json(Path(path), "plan"), Path(path), kind)


def plan_from_content(raw: Any, path: Path, kind: type[Plan]) -> Plan:
    """Return the plan of class `kind` that `plan_content` gave; `path` is where it was read, for messages."""
    content = _parse(raw, path)
    problem = _problem(content, path)
    try:
        poses = np.array([as_pose(T, f"pose {i}") for i, T in enumerate(content.poses)])
        given = _given(content.given.start, "start"), _given(content.given.goal, "goal")
    except PoseError as error:
        raise PlanFileError(f"'{path}': {error}") from error
    plan = kind(
        status=Status[content.status.upper()],
        poses=poses,
        placements=_rests(content, problem, path),
        xi=np.array(content.xi, dtype=np.float64).reshape(-1, 3),
        transitions=tuple(_transition(t, problem, path) for t in content.transitions),
        cost=float("nan") if content.cost is None else content.cost,
        timings=content.timings,
        refiner_stats=content.refiner_stats,
        seed=content.seed,
        problem=problem,
        given=given,
    )
    counts = {len(plan.placements), len(plan.xi), content.num_regrasps, len(poses) - 2}
    if len(counts) != 1 or len(plan.transitions) not in (0, len(poses) - 1):
        raise PlanFileError(f"'{path}': the numbers of poses, placements and transitions disagree; save the plan again")
    return plan


def _parse(raw: Any, path: Path) -> _File:
    version = raw.get("schema") if isinstance(raw, dict) else None
    if type(version) is not int or version not in _SCHEMAS:
        known = " and ".join(map(str, _SCHEMAS))
        raise PlanFileError(f"'{path}' has plan schema {version!r}; this version reads schemas {known}")
    content = validated(raw, _SCHEMAS[version], f"'{path}'", PlanFileError)
    if content.status.upper() not in Status.__members__:
        known = ", ".join(name.lower() for name in Status.__members__)
        raise PlanFileError(f"'{path}': unknown status '{content.status}'; known: {known}")
    return content


def _problem(content: _File, path: Path) -> RegraspProblem:
    what = content.object
    name = what.name if what.source == "built-in" else what.source
    given = what.mass_properties.given()
    try:
        body = load_object(name, scale=what.scale, repair=what.repair, thickness=what.thickness, **given)
    except OptionError as error:
        raise PlanFileError(
            f"the object '{what.name}' has changed since the plan '{path}' was made: {error}"
        ) from error
    if body.fingerprint() != what.fingerprint or body.given.given() != given:
        raise PlanFileError(f"the object '{what.name}' has changed since the plan '{path}' was made; plan again")
    cell = _unchanged_cell(content.workcell, path)
    try:
        T = np.array([as_pose(g.T_object_tcp, f"grasp {i}") for i, g in enumerate(content.grasps)])
    except PoseError as error:
        raise PlanFileError(f"'{path}': {error}") from error
    widths = np.array([g.width for g in content.grasps])
    names = tuple(g.name for g in content.grasps if g.name is not None)
    if names and len(names) != len(T):
        raise PlanFileError(f"'{path}': some grasps have names and others have none; save the plan again")
    grasps = GraspSet(T.reshape(-1, 4, 4), widths, cell.arm.end_effector.kind, names)
    return assemble(body, cell, grasps, find_model(body, cell))  # all of them: transitions name them by number


def _unchanged_cell(record: _Workcell | _Workcell1, path: Path) -> Workcell:
    name = record.name if record.source == "built-in" else record.source
    cell = load_workcell(name, end_effector=record.end_effector)
    if isinstance(record, _Workcell):
        cell = cell.with_obstacles(obstacle.shape() for obstacle in record.obstacles if obstacle.added)
        if added_fingerprint(record.obstacles) != record.added_fingerprint:
            raise PlanFileError(f"the obstacles of the plan '{path}' were changed in its file; plan again")
        changes = scene_changes(record, cell)
    else:
        changes = [] if cell.fingerprint() == record.fingerprint else ["schema 1 does not tell what"]
    if changes:
        more = f", and {len(changes) - NAMED} more" if len(changes) > NAMED else ""
        raise PlanFileError(
            f"the workcell '{record.name}' has changed since the plan '{path}' was made "
            f"({', '.join(changes[:NAMED])}{more}); plan again"
        )
    return cell


def _rests(content: _File, problem: RegraspProblem, path: Path) -> IntArray:
    """Return the numbers (N,) of the rests of the intermediate poses."""
    supports = [None] * len(content.placements) if content.supports is None else content.supports
    if len(supports) != len(content.placements):
        raise PlanFileError(f"'{path}': the numbers of placements and supports disagree; save the plan again")
    try:
        found = [problem.rests.number(s, m) for s, m in zip(supports, content.placements, strict=True)]
    except PoseError as error:
        raise PlanFileError(f"'{path}': {error}; save the plan again") from error
    return np.array(found, dtype=np.int64)


def _transition(record: _Transition, problem: RegraspProblem, path: Path) -> Transition:
    count, dof = len(record.grasp_ids), problem.workcell.arm.robot.dof
    rows = [*record.q_pick, *record.q_place]
    sizes = {len(record.q_pick), len(record.q_place), len(record.clearance), count}
    if len(sizes) != 1 or any(len(row) != dof for row in rows):
        raise PlanFileError(f"'{path}': a transition's configurations do not fit its grasps; save the plan again")
    if any(not 0 <= g < len(problem.grasps) for g in record.grasp_ids):
        raise PlanFileError(f"'{path}': a transition names a grasp that the file does not hold; save the plan again")
    return Transition(
        np.array(record.grasp_ids, dtype=np.int64),
        np.array(record.q_pick, dtype=np.float64).reshape(count, dof),
        np.array(record.q_place, dtype=np.float64).reshape(count, dof),
        np.array(record.clearance, dtype=np.float64),
        problem.workcell.arm.name,
    )
