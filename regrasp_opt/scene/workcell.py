"""The workcell: arm, supports, obstacles, and where objects may stand. World frame, z up."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.errors import WorkcellError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.shapes import Shape, shape_parts
from regrasp_opt.robots import Robot
from regrasp_opt.scene.arm import Arm
from regrasp_opt.scene.support import Support


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
        Links of the arm to the supports, the obstacles and the object.
    gripper : float
        End-effector to the supports and the obstacles.
    self_collision : float
        Links and end-effector to the other links.
    """

    arm: float = 0.005
    gripper: float = 0.003
    self_collision: float = 0.0


@dataclass(frozen=True, eq=False)
class Workcell:
    """An arm with its surroundings, as `load_workcell` makes it.

    Attributes
    ----------
    name : str
        Short name, for messages.
    arm : Arm
        The robot on its base, with its tool.
    supports : tuple of Support
        What objects stand on: one, the table, for now. The base may stand on it as well.
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
    added : tuple of str
        Names of the obstacles that are not in the file.
    """

    name: str
    arm: Arm
    supports: tuple[Support, ...]
    obstacles: tuple[Shape, ...]
    bounds: WorkspaceBounds
    clearance: Clearance
    source: str = "built-in"
    end_effector_override: str | None = None
    added: tuple[str, ...] = ()

    @property
    def robot(self) -> Robot:
        """The robot of the arm."""
        return self.arm.robot

    @property
    def end_effector(self) -> EndEffector:
        """The tool of the arm."""
        return self.arm.end_effector

    @property
    def T_world_base(self) -> FloatArray:
        """Where the base of the arm stands (4, 4)."""
        return self.arm.T_world_base

    @property
    def table(self) -> Support:
        """The support of a workcell that has one."""
        (support,) = self.supports
        return support

    def with_obstacles(self, shapes: Iterable[Shape]) -> Workcell:
        """Return this workcell with the obstacles `shapes` besides its own; plan files keep them.

        Raises
        ------
        WorkcellError
            If two obstacles, or one and a support, have the same name.
        """
        shapes = tuple(shapes)
        added = (*self.added, *(shape.name for shape in shapes))
        cell = replace(self, obstacles=(*self.obstacles, *shapes), added=added)
        if cell.repeated_name is not None:
            raise WorkcellError(f"the name '{cell.repeated_name}' is taken; give each obstacle its own")
        return cell

    @property
    def as_loaded(self) -> Workcell:
        """The workcell without the obstacles that were put in afterwards."""
        kept = tuple(shape for shape in self.obstacles if shape.name not in self.added)
        return replace(self, obstacles=kept, added=())

    @property
    def repeated_name(self) -> str | None:
        """A name that two of the supports and the obstacles have, or None."""
        names = [*(support.name for support in self.supports), *(shape.name for shape in self.obstacles)]
        return next((name for name in names if names.count(name) > 1), None)

    def fingerprint(self) -> str:
        """Return a hash of everything that decides which grasps are feasible; names and home do not."""
        distances = [self.clearance.arm, self.clearance.gripper, self.clearance.self_collision]
        return content_hash(
            "workcell",
            self.arm.robot.fingerprint(),
            self.arm.T_world_base,
            self.arm.end_effector.fingerprint(),
            [shape_parts(shape) for shape in (*(s.shape for s in self.supports), *self.obstacles)],
            np.array([self.bounds.x, self.bounds.y]),
            np.array(distances),
        )
