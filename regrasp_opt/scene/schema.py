"""What a workcell file may hold."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from regrasp_opt.schemas import Section, ascending

SIZE_KEYS = {"box": ("size",), "cylinder": ("radius", "length"), "mesh": ("file",)}
"""The keys that each type of obstacle needs besides its name and pose."""


Length = Annotated[float, Field(gt=0)]
Distance = Annotated[float, Field(ge=0, le=0.1)]
Interval = Annotated[tuple[float, float], AfterValidator(ascending)]
Vector = tuple[float, float, float]


class MountingSection(Section):
    """Where a robot's base stands in the world, where it rests, and how its file is read."""

    tip: str | None = None
    tip_position: Vector | None = None
    tip_rpy: Vector | None = None
    position: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    home: list[float] | str | None = None
    ignore_collisions: list[tuple[str, str]] = Field(default_factory=list)
    package_dirs: list[str] = Field(default_factory=list)
    srdf: str | None = None
    locked: dict[str, float] | None = None
    leave_out: list[str] | None = None
    xacro_args: dict[str, str] | None = None


class RobotSection(MountingSection):
    """Which robot, where its base stands in the world, and where it rests."""

    model: str


class EndEffectorSection(Section):
    """Which end-effector."""

    model: str


class TableSection(Section):
    """The table's top [m]."""

    height: float = 0.0
    center: tuple[float, float]
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


class HeldPoseSection(Section):
    """A pose of an object in a fixture, in the fixture's frame [m, rad]."""

    name: str
    position: Vector
    rpy: Vector = (0.0, 0.0, 0.0)
    object: str | None = None


class SupportSection(Section):
    """A board, by default, or a fixture, whose bodies and poses are given in its own frame [m, rad]."""

    name: str
    kind: Literal["board", "fixture"] = "board"
    rpy: Vector = (0.0, 0.0, 0.0)
    weight: float = 0.0
    height: float | None = None
    center: tuple[float, float] | None = None
    size: tuple[Length, Length] | None = None
    thickness: Length | None = None
    workspace: WorkspaceSection | None = None
    friction: Annotated[float, Field(gt=0, le=2)] | None = None
    position: Vector | None = None
    bodies: list[ObstacleSection] | None = None
    poses: list[HeldPoseSection] | None = None

    @model_validator(mode="after")
    def _keys_of_the_kind(self) -> SupportSection:
        needed = {"board": ("center", "size"), "fixture": ("position", "poses")}
        board = ("height", "center", "size", "thickness", "workspace", "friction")
        fixture = ("position", "bodies", "poses")
        mine, others = (board, fixture) if self.kind == "board" else (fixture, board)
        for key in others:
            if getattr(self, key) is not None:
                raise ValueError(f"a {self.kind} has no key '{key}'; allowed: name, rpy, weight, {', '.join(mine)}")
        for key in needed[self.kind]:
            if not getattr(self, key):
                raise ValueError(f"a {self.kind} needs the key '{key}'")
        return self


class ArmSection(MountingSection):
    """An arm: the robot, where its base stands in the world and where it rests, and its tool."""

    name: str = "arm"
    robot: str
    end_effector: str


class WorkcellFile(Section):
    """The whole file, with any number of supports."""

    schema_: Literal[2] = Field(alias="schema")
    name: str | None = None
    arms: Annotated[list[ArmSection], Field(min_length=1, max_length=1)]
    supports: Annotated[list[SupportSection], Field(min_length=1)]
    clearance: ClearanceSection = ClearanceSection()
    obstacles: list[ObstacleSection] = Field(default_factory=list)


class WorkcellFile1(Section):
    """The whole file, with one arm and one table."""

    schema_: Literal[1] = Field(alias="schema")
    name: str | None = None
    robot: RobotSection
    end_effector: EndEffectorSection
    table: TableSection
    workspace: WorkspaceSection
    clearance: ClearanceSection = ClearanceSection()
    obstacles: list[ObstacleSection] = Field(default_factory=list)

    def current(self) -> WorkcellFile:
        """Return the same as a file of the current schema."""
        robot = self.robot.model_dump()
        arm = {"robot": robot.pop("model"), "end_effector": self.end_effector.model, **robot}
        table = {"name": "table", **self.table.model_dump(), "workspace": self.workspace.model_dump()}
        rest = {key: getattr(self, key) for key in ("name", "clearance", "obstacles")}
        return WorkcellFile.model_validate({"schema": 2, "arms": [arm], "supports": [table], **rest})


class ObstaclesFile(Section):
    """A file of obstacles that are put into a workcell when a plan is asked for."""

    schema_: Literal[1] = Field(default=1, alias="schema")
    obstacles: list[ObstacleSection] = Field(min_length=1)
