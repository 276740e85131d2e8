"""End-effectors from TOML files: the built-in ones by name, any other by path."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from regrasp_opt.conventions import translation
from regrasp_opt.end_effectors.model import EndEffector, Pad, default_pad
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder
from regrasp_opt.schemas import Section, ascending, read_toml

END_EFFECTOR_NAMES = ("w", "r140", "r85", "s1", "s2", "s3")
"""The built-in end-effectors: gripper W, Robotiq-140, Robotiq-85, suction cups S1, S2 and S3."""


Positive = Annotated[float, Field(gt=0, le=1)]
Coordinate = Annotated[float, Field(ge=-1, le=1)]
Interval = Annotated[tuple[Coordinate, Coordinate], AfterValidator(ascending)]


class _BoxSchema(Section):
    x: Interval
    y: Interval
    z: Interval

    def build(self, name: str) -> Box:
        low, high = np.array([self.x, self.y, self.z]).T
        return Box(name, high - low, translation(*((low + high) / 2)))


class _CylinderSchema(Section):
    radius: Positive
    z: Interval

    def build(self, name: str) -> Cylinder:
        return Cylinder(name, self.radius, self.z[1] - self.z[0], translation(0.0, 0.0, sum(self.z) / 2))


class _BodySchema(Section):
    name: str
    box: _BoxSchema | None = None
    cylinder: _CylinderSchema | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> _BodySchema:
        if (self.box is None) == (self.cylinder is None):
            raise ValueError("should have either a box or a cylinder")
        return self

    def build(self) -> Box | Cylinder:
        shape = self.box or self.cylinder
        assert shape is not None
        return shape.build(self.name)


class _FingerSchema(Section):
    name: str
    box: _BoxSchema


class _PadSchema(Section):
    x: Interval
    z: Interval


class _EndEffectorSchema(Section):
    name: str | None = None
    kind: Literal["parallel", "suction"]
    tcp_offset: Positive
    max_opening: Positive | None = None
    pre_opening: Annotated[float, Field(ge=0, le=0.1)] | None = None
    cup_radius: Positive | None = None
    body: Annotated[list[_BodySchema], Field(min_length=1)]
    finger: list[_FingerSchema] = Field(default_factory=list)
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
        If the file is missing or is not TOML, or holds a wrong key or value; the message names
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
    return read_toml(text, _EndEffectorSchema, where).build(name, source)
