"""Plans as JSON (docs/plan-file.md): versioned, written atomically, read back with every field checked."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from regrasp_opt.conventions import as_pose
from regrasp_opt.errors import PlanFileError, PoseError
from regrasp_opt.files import atomic_path
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import load_object
from regrasp_opt.planning.model_store import find_model
from regrasp_opt.planning.plan_data import PlanData, Status, Transition
from regrasp_opt.planning.problem import RegraspProblem, assemble
from regrasp_opt.scene import load_workcell

SCHEMA = 1

Row = list[float]
Planar = Annotated[list[float], Field(min_length=3, max_length=3)]
Number = Annotated[int, Field(ge=0, lt=2**31)]


Plan = TypeVar("Plan", bound=PlanData)


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Reference(_Record):
    source: str
    name: str
    fingerprint: str
    scale: float = 1.0
    repair: bool = False
    end_effector: str | None = None


class _Grasp(_Record):
    T_object_tcp: list[Row]
    width: Annotated[float, Field(ge=0)]


class _Transition(_Record):
    grasp_ids: list[Number]
    q_pick: list[Row]
    q_place: list[Row]
    clearance: list[float]


class _File(_Record):
    schema_: int = Field(alias="schema")
    status: str
    num_regrasps: int
    cost: float | None
    poses: list[list[Row]]
    transitions: list[_Transition]
    timings: dict[str, float]
    placements: list[Number]
    xi: list[Planar]
    seed: int
    refiner_stats: list[dict[str, Any]]
    object: _Reference
    workcell: _Reference
    grasps: Annotated[list[_Grasp], Field(min_length=1)]


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
        "placements": plan.placements.tolist(),
        "xi": plan.xi.tolist(),
        "seed": plan.seed,
        "refiner_stats": plan.refiner_stats,
        "object": {
            "source": _absolute(body.source),
            "name": body.name,
            "fingerprint": body.fingerprint(),
            "scale": body.scale,
            "repair": body.repair,
        },
        "workcell": {
            "source": _absolute(cell.source),
            "name": cell.name,
            "fingerprint": cell.fingerprint(),
            "end_effector": cell.end_effector_override,
        },
        "grasps": [
            {"T_object_tcp": T.tolist(), "width": float(w)}
            for T, w in zip(problem.grasps.T_object_tcp, problem.grasps.width, strict=True)
        ],
    }


def load_plan(path: str | os.PathLike[str], kind: type[Plan]) -> Plan:
    """Read a plan of class `kind`; see `RegraspPlan.load`."""
    return plan_from_content(read_json(Path(path), "plan"), Path(path), kind)


def plan_from_content(raw: Any, path: Path, kind: type[Plan]) -> Plan:
    """Return the plan of class `kind` that `plan_content` gave; `path` is where it was read, for messages."""
    content = _parse(raw, path)
    problem = _problem(content, path)
    try:
        poses = np.array([as_pose(T, f"pose {i}") for i, T in enumerate(content.poses)])
    except PoseError as error:
        raise PlanFileError(f"'{path}': {error}") from error
    plan = kind(
        status=Status[content.status.upper()],
        poses=poses,
        placements=np.array(content.placements, dtype=np.int64),
        xi=np.array(content.xi, dtype=np.float64).reshape(-1, 3),
        transitions=tuple(_transition(t, problem, path) for t in content.transitions),
        cost=float("nan") if content.cost is None else content.cost,
        timings=content.timings,
        refiner_stats=content.refiner_stats,
        seed=content.seed,
        problem=problem,
    )
    counts = {len(plan.placements), len(plan.xi), content.num_regrasps, len(poses) - 2}
    if len(counts) != 1 or len(plan.transitions) not in (0, len(poses) - 1):
        raise PlanFileError(f"'{path}': the numbers of poses, placements and transitions disagree; save the plan again")
    return plan


def _absolute(source: str) -> str:
    return source if source == "built-in" else str(Path(source).resolve())


def read_json(path: Path, what: str) -> Any:
    """Return the content of the JSON file `path`; `what` it should hold is named in errors.

    Raises
    ------
    PlanFileError
        If it cannot be read or is not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PlanFileError(f"cannot read the {what} '{path}': {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"'{path}' is not valid JSON; it may be cut short: save the {what} again") from error


Content = TypeVar("Content", bound=BaseModel)


def validated(kind: type[Content], raw: Any, path: Path, advice: str) -> Content:
    """Return `raw` as `kind`, or raise a PlanFileError that names the first wrong field and ends with `advice`."""
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise PlanFileError(f"'{path}': the field '{where}' is wrong ({first['msg']}); {advice}") from error


def _parse(raw: Any, path: Path) -> _File:
    version = raw.get("schema") if isinstance(raw, dict) else None
    if version != SCHEMA:
        raise PlanFileError(f"'{path}' has plan schema {version!r}; this version reads schema {SCHEMA}")
    content = validated(_File, raw, path, "save the plan again")
    if content.status.upper() not in Status.__members__:
        known = ", ".join(name.lower() for name in Status.__members__)
        raise PlanFileError(f"'{path}': unknown status '{content.status}'; known: {known}")
    return content


def _problem(content: _File, path: Path) -> RegraspProblem:
    body_ref, cell_ref = content.object, content.workcell
    body = load_object(
        body_ref.name if body_ref.source == "built-in" else body_ref.source,
        scale=body_ref.scale,
        repair=body_ref.repair,
    )
    cell = load_workcell(
        cell_ref.name if cell_ref.source == "built-in" else cell_ref.source,
        end_effector=cell_ref.end_effector,
    )
    for item, reference, what in ((body, body_ref, "object"), (cell, cell_ref, "workcell")):
        if item.fingerprint() != reference.fingerprint:
            raise PlanFileError(
                f"the {what} '{reference.name}' has changed since the plan '{path}' was made; plan again"
            )
    try:
        T = np.array([as_pose(g.T_object_tcp, f"grasp {i}") for i, g in enumerate(content.grasps)])
    except PoseError as error:
        raise PlanFileError(f"'{path}': {error}") from error
    widths = np.array([g.width for g in content.grasps])
    grasps = GraspSet(T.reshape(-1, 4, 4), widths, cell.arm.end_effector.kind)
    return assemble(body, cell, grasps, find_model(body, cell))  # all of them: transitions name them by number


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
    )
