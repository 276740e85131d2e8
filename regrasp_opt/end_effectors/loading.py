"""End-effectors from TOML files: the built-in ones by name, any other by path."""

from __future__ import annotations

import os
import sys
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from regrasp_opt.conventions import translation
from regrasp_opt.end_effectors.model import EndEffector, Pad, default_pad
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.shapes import Box, Cylinder

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

END_EFFECTOR_NAMES = ("w", "r140", "r85", "s1", "s2", "s3")
"""The built-in end-effectors: gripper W, Robotiq-140, Robotiq-85, suction cups S1, S2 and S3."""


def _ascending(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] >= interval[1]:
        raise ValueError("input should be [low, high] with low < high")
    return interval


Positive = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Interval = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_ascending)]


class _Schema(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class _BoxSchema(_Schema):
    x: Interval
    y: Interval
    z: Interval

    def build(self, name: str) -> Box:
        low, high = np.array([self.x, self.y, self.z]).T
        return Box(name, high - low, translation(*((low + high) / 2)))


class _CylinderSchema(_Schema):
    radius: Positive
    z: Interval

    def build(self, name: str) -> Cylinder:
        return Cylinder(name, self.radius, self.z[1] - self.z[0], translation(0.0, 0.0, sum(self.z) / 2))


class _BodySchema(_Schema):
    name: str
    box: _BoxSchema | None = None
    cylinder: _CylinderSchema | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> _BodySchema:
        if (self.box is None) == (self.cylinder is None):
            raise ValueError("input should have either a box or a cylinder")
        return self

    def build(self) -> Box | Cylinder:
        shape = self.box or self.cylinder
        assert shape is not None
        return shape.build(self.name)


class _FingerSchema(_Schema):
    name: str
    box: _BoxSchema


class _PadSchema(_Schema):
    x: Interval
    z: Interval


class _EndEffectorSchema(_Schema):
    name: str | None = None
    kind: Literal["parallel", "suction"]
    tcp_offset: Positive
    max_opening: Positive | None = None
    pre_opening: Annotated[float, Field(ge=0, le=0.1)] | None = None
    cup_radius: Positive | None = None
    body: Annotated[list[_BodySchema], Field(min_length=1)]
    finger: list[_FingerSchema] = []
    pad: _PadSchema | None = None

    @model_validator(mode="after")
    def _keys_of_the_kind(self) -> _EndEffectorSchema:
        parallel = self.kind == "parallel"
        needed = ("max_opening", "finger") if parallel else ("cup_radius",)
        other = ("cup_radius",) if parallel else ("max_opening", "pre_opening", "finger", "pad")
        for key in needed:
            if not getattr(self, key):
                raise ValueError(f"kind '{self.kind}' needs the key '{key}'")
        for key in other:
            if getattr(self, key):
                raise ValueError(f"kind '{self.kind}' has no key '{key}'; it needs {', '.join(needed)}")
        return self

    def build(self, name: str, source: str) -> EndEffector:
        parallel = self.kind == "parallel"
        finger = tuple(shape.box.build(shape.name) for shape in self.finger)
        usual = default_pad(finger)
        given = usual if self.pad is None else Pad(self.pad.x, self.pad.z)
        return EndEffector(
            name=self.name or name,
            kind=self.kind,
            tcp_offset=self.tcp_offset,
            max_opening=self.max_opening or 0.0,
            pre_opening=(0.005 if self.pre_opening is None else self.pre_opening) if parallel else 0.0,
            cup_radius=self.cup_radius or 0.0,
            body=tuple(shape.build() for shape in self.body),
            finger=finger,
            pad=usual if np.allclose(given, usual, rtol=0.0, atol=1e-9) else given,
            source=source,
        )


def load_end_effector(name_or_path: str | os.PathLike[str]) -> EndEffector:
    """Return a built-in end-effector by name, or any other from the path of its TOML file.

    A string is taken as a path when it ends in ``.toml`` or has a folder in it.

    Raises
    ------
    UnknownNameError
        If the string is neither a built-in name nor a path.
    WorkcellError
        If the file is missing or is no TOML, or holds a wrong key or value; the message names
        the file, the key and what is allowed.
    """
    if isinstance(name_or_path, str) and name_or_path in END_EFFECTOR_NAMES:
        resource = files("regrasp_opt") / "data" / "end_effectors" / f"{name_or_path}.toml"
        return _parse(resource.read_text("utf-8"), name_or_path, "built-in")
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and path.suffix.lower() != ".toml" and path.name == name_or_path:
        raise UnknownNameError("end-effector", name_or_path, END_EFFECTOR_NAMES)
    try:
        text = path.read_text("utf-8")
    except (OSError, ValueError) as error:
        raise WorkcellError(f"end-effector file {path} cannot be read; give the path of a TOML file") from error
    return _parse(text, path.stem, str(path))


def _parse(text: str, name: str, source: str) -> EndEffector:
    where = f"end-effector '{name}'" if source == "built-in" else source
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise WorkcellError(f"{where} is not valid TOML: {error}") from error
    try:
        schema = _EndEffectorSchema.model_validate(data)
    except ValidationError as error:
        raise WorkcellError(f"{where}: {describe(error, _EndEffectorSchema)}") from error
    return schema.build(name, source)


def describe(error: ValidationError, schema: type[BaseModel]) -> str:
    """Return one problem of a pydantic error as a clause: the key, what is wrong, what is allowed.

    An unknown key comes first: it is usually the misspelling behind a missing one.
    """
    problems: list[Any] = [*error.errors(include_url=False)]
    problem = next((one for one in problems if one["type"] == "extra_forbidden"), problems[0])
    location = problem["loc"]
    parent = _schema_at(schema, location[:-1])
    key = ".".join(str(part) for part in location)
    if parent is not None and problem["type"] == "extra_forbidden":
        return f"unknown key '{key}'; allowed: {', '.join(parent.model_fields)}"
    if parent is not None and problem["type"] == "missing":
        return f"key '{key}' is missing; needed here: {', '.join(_required(parent))}"
    message = problem["msg"].removeprefix("Value error, ")
    given = problem["input"]
    shown = f", not {given!r}" if isinstance(given, (str, int, float, list, tuple)) else ""
    return f"key '{key}': {message}{shown}" if key else message


def _required(schema: type[BaseModel]) -> list[str]:
    return [name for name, field in schema.model_fields.items() if field.is_required()]


def _schema_at(schema: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel] | None:
    """Return the schema of the table at `location`; None where that is a value, such as an interval."""
    for part in location:
        if isinstance(part, str):
            inner = _schemas_in(schema.model_fields[part].annotation)
            if not inner:
                return None
            schema = inner[0]
    return schema


def _schemas_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [schema for inner in getattr(annotation, "__args__", ()) for schema in _schemas_in(inner)]
