"""What a workcell file may hold, checked by pydantic, and its errors as one sentence."""

from __future__ import annotations

import difflib
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

SIZE_KEYS = {"box": ("size",), "cylinder": ("radius", "length"), "mesh": ("file",)}
"""The keys that each type of obstacle needs besides its name and pose."""


def _ascending(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] >= interval[1]:
        raise ValueError("should be [low, high] with low < high")
    return interval


Number = Annotated[float, Field(allow_inf_nan=False)]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Distance = Annotated[float, Field(ge=0, le=0.1, allow_inf_nan=False)]
Interval = Annotated[tuple[Number, Number], AfterValidator(_ascending)]
Vector = tuple[Number, Number, Number]


class Section(BaseModel):
    """A table of the file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class RobotSection(Section):
    """Which robot, where its base stands in the world, and where it rests."""

    model: str
    tip: str | None = None
    position: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    home: list[Number] | None = None
    ignore_collisions: list[tuple[str, str]] = []
    package_dirs: list[str] = []


class EndEffectorSection(Section):
    """Which end-effector."""

    model: str


class TableSection(Section):
    """The table's top [m]."""

    height: Number = 0.0
    center: tuple[Number, Number]
    size: tuple[Length, Length]
    thickness: Length = 0.05


class WorkspaceSection(Section):
    """Where objects may be put down [m]."""

    x: Interval
    y: Interval


class ClearanceSection(Section):
    """Distances to keep [m]."""

    arm: Distance = 0.005
    gripper: Distance = 0.003
    self_collision: Distance = 0.0


class ObstacleSection(Section):
    """One fixed shape in the world frame [m, rad]."""

    type: Literal["box", "cylinder", "mesh"]
    name: str
    position: Vector
    rpy: Vector = (0.0, 0.0, 0.0)
    size: tuple[Length, Length, Length] | None = None
    radius: Length | None = None
    length: Length | None = None
    file: str | None = None
    scale: Length | None = None

    @model_validator(mode="after")
    def _keys_of_the_type(self) -> ObstacleSection:
        allowed = (*SIZE_KEYS[self.type], *(("scale",) if self.type == "mesh" else ()))
        for key in SIZE_KEYS[self.type]:
            if getattr(self, key) is None:
                raise ValueError(f"a {self.type} needs the key '{key}'")
        for key in ("size", "radius", "length", "file", "scale"):
            if getattr(self, key) is not None and key not in allowed:
                raise ValueError(f"a {self.type} has no key '{key}'; allowed: {', '.join(allowed)}")
        return self


class WorkcellFile(Section):
    """The whole file."""

    schema_: Literal[1] = Field(alias="schema")
    name: str | None = None
    robot: RobotSection
    end_effector: EndEffectorSection
    table: TableSection
    workspace: WorkspaceSection
    clearance: ClearanceSection = ClearanceSection()
    obstacles: list[ObstacleSection] = []


def describe(error: ValidationError) -> str:
    """Return the first problem of `error` as a clause: the key, what is wrong with it, what is allowed.

    An unknown key comes first, for it is usually the misspelling behind a missing one.
    """
    problems: list[Any] = list(error.errors(include_url=False))
    problem = next((one for one in problems if one["type"] == "extra_forbidden"), problems[0])
    location = problem["loc"]
    key = ".".join(str(part) for part in location)
    if problem["type"] == "extra_forbidden":
        keys = _keys_at(location[:-1])
        close = difflib.get_close_matches(str(location[-1]), keys, n=len(keys), cutoff=0.4)
        return f"unknown key '{key}'; allowed: {', '.join([*close, *(k for k in keys if k not in close)])}"
    if problem["type"] == "missing":
        return f"key '{key}' is missing; add it"
    message = problem["msg"].removeprefix("Value error, ").removeprefix("Input ")
    given = problem["input"]
    shown = "" if isinstance(given, dict) else f", not {given!r}"
    return f"key '{key}': {message}{shown}"


def _keys_at(location: tuple[int | str, ...]) -> list[str]:
    """Return the keys allowed at `location`; every table of the file stands at most one level deep."""
    section: Any = WorkcellFile
    for part in location:
        if isinstance(part, str):
            annotation = WorkcellFile.model_fields[part].annotation
            section = getattr(annotation, "__args__", (annotation,))[0]
    return [field.alias or name for name, field in section.model_fields.items()]
