"""The workcell: robot, end-effector, table, obstacles, and where objects may stand. World frame, z up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from regrasp_opt.conventions import FloatArray, invert, translation
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.shapes import Box, Cylinder, Shape
from regrasp_opt.robots import Robot


@dataclass(frozen=True, eq=False)
class Table:
    """A table with a horizontal top.

    Attributes
    ----------
    height : float
        z of the top [m].
    center, size : (2,) arrays
        Middle and edge lengths of the top in x and y [m].
    thickness : float
        Thickness below the top [m].
    """

    height: float
    center: FloatArray
    size: FloatArray
    thickness: float

    @cached_property
    def shape(self) -> Box:
        """The table as a box whose upper face is the top."""
        pose = translation(float(self.center[0]), float(self.center[1]), self.height - self.thickness / 2)
        return Box("table", np.array([*self.size, self.thickness]), pose)


@dataclass(frozen=True)
class WorkspaceBounds:
    """The rectangle of object positions, ``(low, high)`` in x and in y [m]."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def array(self) -> FloatArray:
        """The low and the high corner (2, 2): ``[[x_low, y_low], [x_high, y_high]]`` [m]."""
        return np.array([self.x, self.y]).T


@dataclass(frozen=True)
class Clearance:
    """Least distances that count as free of collision [m].

    Attributes
    ----------
    arm : float
        Links of the arm to the table, the obstacles and the object.
    gripper : float
        End-effector to the table and the obstacles.
    self_collision : float
        Links and end-effector to the other links.
    """

    arm: float = 0.005
    gripper: float = 0.003
    self_collision: float = 0.0


@dataclass(frozen=True, eq=False)
class Workcell:
    """A robot with its tool and surroundings, as `load_workcell` makes it.

    Attributes
    ----------
    name : str
        Short name, for messages.
    robot : Robot
        The arm; the end-effector's flange frame is the robot's tip frame.
    T_world_base : (4, 4) array
        Where the robot's base stands.
    end_effector : EndEffector
        The tool.
    table : Table
        What objects stand on; the base may stand on it as well.
    obstacles : tuple of Shape
        Fixed shapes in the world frame.
    bounds : WorkspaceBounds
        Where objects may be put down.
    clearance : Clearance
        Distances to keep.
    source : str
        ``"built-in"`` or the path of the file it was read from.
    end_effector_override : str or None
        The end-effector that `load_workcell` was told to use instead of the file's.
    """

    name: str
    robot: Robot
    T_world_base: FloatArray
    end_effector: EndEffector
    table: Table
    obstacles: tuple[Shape, ...]
    bounds: WorkspaceBounds
    clearance: Clearance
    source: str = "built-in"
    end_effector_override: str | None = None

    @cached_property
    def T_base_world(self) -> FloatArray:
        """The world frame seen from the robot's base (4, 4)."""
        return invert(self.T_world_base)

    def fingerprint(self) -> str:
        """Return a hash of everything that decides which grasps are feasible; names and home do not."""
        distances = [self.clearance.arm, self.clearance.gripper, self.clearance.self_collision]
        return content_hash(
            "workcell",
            self.robot.fingerprint(),
            self.T_world_base,
            self.end_effector.fingerprint(),
            [_shape_parts(shape) for shape in (self.table.shape, *self.obstacles)],
            np.array([self.bounds.x, self.bounds.y]),
            np.array(distances),
        )


def _shape_parts(shape: Shape) -> list[object]:
    if isinstance(shape, Box):
        return ["box", np.asarray(shape.size, dtype=np.float64), shape.pose]
    if isinstance(shape, Cylinder):
        return ["cylinder", np.array([shape.radius, shape.length]), shape.pose]
    return ["mesh", shape.vertices, shape.faces, shape.pose]
