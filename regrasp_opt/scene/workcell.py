"""The workcell: arm, supports, obstacles, and where objects may stand. World frame, z up."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.shapes import Shape, shape_parts
from regrasp_opt.robots import Robot
from regrasp_opt.scene.arm import Arm
from regrasp_opt.scene.support import Fixture, Support, WorkspaceBounds


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
    supports : tuple of Support or Fixture
        What objects stand on. The first is a board, where poses are meant that name no support; the base may stand on
        it as well.
    obstacles : tuple of Shape
        Fixed shapes in the world frame.
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
    supports: tuple[Support | Fixture, ...]
    obstacles: tuple[Shape, ...]
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
        """The first support."""
        first = self.supports[0]
        assert isinstance(first, Support)
        return first

    @property
    def boards(self) -> tuple[Support, ...]:
        """The supports that are boards."""
        return tuple(support for support in self.supports if isinstance(support, Support))

    @property
    def bounds(self) -> WorkspaceBounds:
        """Where objects may be put down on the first support."""
        return self.table.workspace

    def within(self, bounds: WorkspaceBounds) -> Workcell:
        """Return this workcell with another workspace on its first support."""
        return replace(self, supports=(replace(self.table, workspace=bounds), *self.supports[1:]))

    def support(self, name: str | None) -> Support | Fixture:
        """Return the support of that name, the first one for None.

        Raises
        ------
        UnknownNameError
            If there is none.
        """
        found = next((each for each in self.supports if name in (None, each.name)), None)
        if found is None:
            raise UnknownNameError("support", str(name), [each.name for each in self.supports])
        return found

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
            [shape_parts(shape) for shape in (*(part for s in self.supports for part in s.shapes), *self.obstacles)],
            np.array([self.bounds.x, self.bounds.y]),
            np.array(distances),
            *(_parts(support) for support in self.supports[1:]),
        )


def _parts(support: Support | Fixture) -> list[FloatArray]:
    """Return what a hash has to know of a support besides its shapes."""
    if isinstance(support, Support):
        return [support.T_world_support, support.workspace.array]
    return [support.T_world_support, *(pose.T_support_object for pose in support.poses)]
