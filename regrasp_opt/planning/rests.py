"""Rests: the ways in which the object of a problem can stand in its workcell, each a placement on a support."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, overload

import numpy as np

from regrasp_opt.conventions import RESTING_TOLERANCE, FloatArray, IntArray, invert, planar_transform
from regrasp_opt.errors import GraspError, PoseError, WorkcellError
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.geometry.shapes import shape_geometry
from regrasp_opt.geometry.solids import Solid, separation
from regrasp_opt.objects import ObjectModel
from regrasp_opt.objects.placements import inner_distance
from regrasp_opt.objects.rolling import LEAST_MARGIN
from regrasp_opt.scene import Fixture, Support, Workcell

NEST_OVERLAP = 1e-3
"""Depth to which an object and the bodies of its fixture may overlap [m]; mesh bodies must stay clear of it."""


class Rest(NamedTuple):
    """One way to stand.

    Attributes
    ----------
    support : Support or Fixture
    placement : int
        Number of the object's stable placement, or of the fixture's pose.
    """

    support: Support | Fixture
    placement: int

    @property
    def label(self) -> str:
        """What messages call it, as in ``shelf/2``."""
        support, number = self
        return f"{support.name}/{support.poses[number].name if isinstance(support, Fixture) else number}"


class Station(NamedTuple):
    """Where the object is at one pose of a plan.

    Attributes
    ----------
    support : str or None
        Name of the support; None where it is on none.
    placement : int or None
        Number of the stable placement, or of the fixture's pose; None where it is in none of them.
    xi : (3,) array or None
        Planar parameters (x, y, theta) in the plane of the support [m, m, rad].
    """

    support: str | None
    placement: int | None
    xi: FloatArray | None


@dataclass(frozen=True, eq=False)
class Rests(Sequence[Rest]):
    """All rests of an object in a workcell; those on the first support come first, in the order of its placements.

    Attributes
    ----------
    items : tuple of Rest
    supports : (S,) int
        Number of the support of each.
    planar : PlanarPoses
        Their poses and the limits of `xi`.
    """

    items: tuple[Rest, ...]
    supports: IntArray
    planar: PlanarPoses

    @staticmethod
    def of(body: ObjectModel, cell: Workcell) -> Rests:
        """Return the rests of `body` on the supports of `cell`.

        On a tilted board those placements remain that are stable at every yaw: the centre of mass moves downhill by the
        tangent of the tilt, in units of its height, as margins are. On any board it must stay above the points that
        touch: a slightly round face, whose margin is that of all of it, would rock on them.
        """
        items, numbers, surfaces, bases, limits, weights = [], [], [], [], [], []
        for number, support in enumerate(cell.supports):
            for k, base, low, high in _on(support, body):
                items.append(Rest(support, k))
                numbers.append(number)
                surfaces.append(support.T_world_support)
                bases.append(base)
                limits.append((low, high))
                weights.append(support.weight)
        shape = (-1, 2, 3)
        low, high = np.moveaxis(np.array(limits, dtype=np.float64).reshape(shape), 1, 0)
        planar = PlanarPoses(
            np.array(surfaces).reshape(-1, 4, 4), np.array(bases).reshape(-1, 4, 4), low, high, np.array(weights)
        )
        return Rests(tuple(items), np.array(numbers, dtype=np.int64), planar)

    def __len__(self) -> int:
        return len(self.items)

    @overload
    def __getitem__(self, number: int) -> Rest: ...
    @overload
    def __getitem__(self, number: slice) -> tuple[Rest, ...]: ...
    def __getitem__(self, number: int | slice) -> Rest | tuple[Rest, ...]:
        """Return the rest of this number."""
        return self.items[number]

    def number(self, support: str | None, placement: int) -> int:
        """Return the number of the rest of `placement` on the support of that name, the first one for None.

        Raises
        ------
        PoseError
            If there is none.
        """
        on = [k for k, rest in enumerate(self.items) if support in (None, rest.support.name)]
        if support is None:
            on = [k for k in on if self.supports[k] == 0]
        for k in on:
            if self.items[k].placement == placement:
                return k
        there = ", ".join(str(self.items[k].placement) for k in on) or "none"
        raise PoseError(f"there is no placement {placement} on '{support}'; there are: {there}")

    def text(self, number: int, xi: FloatArray) -> str:
        """Return rest `number` at `xi` (3,) as the command line takes it, to a millimetre and a tenth of a degree."""
        rest, (x, y, yaw) = self.items[number], xi
        if isinstance(rest.support, Fixture):
            return rest.label
        label = rest.label if (self.supports > 0).any() else str(rest.placement)
        return f"{label}:{x:.3f},{y:.3f},{np.degrees(yaw):.1f}"

    def find(self, T: FloatArray, tolerance: float) -> tuple[int, FloatArray] | None:
        """Return the rest that the object is in at `T` (4, 4), and xi (3,), or None.

        One within its limits comes first, and of these one in a fixture.

        `tolerance` is how far the rotation matrix's entries and the height [m] may together be off.
        """
        if not len(self):
            return None
        xi, error = self.nearest(T)
        inside = np.all((xi >= self.planar.low - tolerance) & (xi <= self.planar.high + tolerance), axis=1)
        fixture = np.isfinite(self.planar.high[:, 2])
        error[~inside & fixture] = np.inf  # it holds the object in one pose only
        close = np.flatnonzero(error <= tolerance)
        if not len(close):
            return None
        number = min(close.tolist(), key=lambda k: (not inside[k], not fixture[k], error[k]))
        return number, xi[number]

    def nearest(self, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return for each rest the xi (S, 3) nearest to `T` (4, 4), and how far it is off (S,): entries and height."""
        local = invert(self.planar.surfaces) @ T
        base = self.planar.bases
        turn = local[:, :3, :3] @ base[:, :3, :3].transpose(0, 2, 1)
        yaw = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
        upright = planar_transform(np.stack([0 * yaw, 0 * yaw, yaw], axis=-1)) @ base
        moved = local[:, :3, 3] - upright[:, :3, 3]
        error = np.abs(upright[:, :3, :3] - local[:, :3, :3]).max(axis=(1, 2)) + np.abs(moved[:, 2])
        return np.column_stack([moved[:, :2], yaw]), error


def check_rests(body: ObjectModel, cell: Workcell) -> None:
    """Raise a GraspError where the object can stand nowhere, and a WorkcellError where it overlaps its own fixture."""
    if not len(Rests.of(body, cell)):
        raise GraspError(
            f"'{body.name}' has no stable placement on a support of '{cell.name}', so it cannot be planned; check its "
            "shape and scale"
        )
    for fixture in cell.supports:
        for pose in fixture.poses if isinstance(fixture, Fixture) else ():
            if pose.object not in (None, body.name):
                continue
            T = fixture.T_world_support @ pose.T_support_object
            for shape in fixture.shapes:
                depth = -separation(body.solid, Solid(shape_geometry(shape)), T, shape.pose)
                if depth > NEST_OVERLAP:
                    raise WorkcellError(
                        f"{cell.source}: '{body.name}' overlaps '{shape.name}' by {depth * 1e3:.1f} mm in pose "
                        f"'{pose.name}' of the fixture '{fixture.name}'; move the pose or the body, or name the object "
                        "that the pose is for"
                    )


def _on(support: Support | Fixture, body: ObjectModel) -> Iterator[tuple[int, FloatArray, FloatArray, FloatArray]]:
    """Yield number, T_support_object (4, 4) and limits of xi, (3,) each, of the ways to be on a support."""
    if isinstance(support, Fixture):
        for k, pose in enumerate(support.poses):
            if pose.object in (None, body.name):
                yield k, pose.T_support_object, np.zeros(3), np.zeros(3)
        return
    low, high = (np.append(side, yaw) for side, yaw in zip(support.workspace.array, (-np.inf, np.inf), strict=True))
    for k, placement in enumerate(body.placements):
        stable = not support.slope or placement.margin - support.slope >= LEAST_MARGIN
        if stable and _keeps(body, k, support.slope):
            yield k, placement.pose, low, high


def _keeps(body: ObjectModel, number: int, slope: float) -> bool:
    """Return whether the centre of mass stays above the points that touch in a placement, tilted whichever way."""
    T = body.placements[number].pose
    points, height = body.vertices @ T[:3, :3].T + T[:3, 3], float((T[:3, :3] @ body.center_of_mass + T[:3, 3])[2])
    return inner_distance(points[points[:, 2] <= RESTING_TOLERANCE], np.array([0.0, 0.0, -1.0])) > slope * height
