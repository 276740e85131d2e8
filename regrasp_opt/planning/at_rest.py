r"""The resting pose that a measured pose means: the one that moves the object's points least.

Over the object's volume, of uniform density with middle :math:`c` and covariance :math:`C`, the mean square motion from
a measured :math:`T_m` to a resting pose :math:`T = T_{ws} \, dT(\xi) \, T_p` is

.. math:: |T c - T_m c|^2 + 2 \, \mathrm{tr}(C) - 2 \, \mathrm{tr}(R \, C \, R_m^T)

which has its least value over :math:`\xi` in closed form: the yaw that maximises the last trace, then x and y that put
the middle above where it was measured. A fixture fixes all three. Whether the pose is in the workspace is for others
to say: to move an object there would be to grasp where it is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, invert, planar_transform, rotation_angle
from regrasp_opt.errors import OptionError, PoseError
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning.rests import Rests

TOLERANCE = (0.005, math.radians(3.0))
"""How far a measured pose may be from rest: distance [m] and angle [rad]."""

_ROUNDING = 1e-9
EXACT = 1e-4
"""A pose whose points rest to within this, in the mean [m], is a resting pose."""


class GivenPose(NamedTuple):
    """What a start or goal was given as, where the plan has another pose that means the same.

    Attributes
    ----------
    T : (4, 4)
        T_world_object, as it was measured.
    turn : (3,), optional
        Rotation vector in the object frame, about the centre of mass [rad]: the symmetry of the object by which the
        plan's pose differs besides; None without one.
    """

    T: FloatArray
    turn: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class RestingPose:
    """A resting pose, and how far a measured one is from it.

    Attributes
    ----------
    T : (4, 4)
        T_world_object.
    support : str
        Name of what the object rests on.
    placement : int
        Number of the stable placement, or of the fixture's pose.
    xi : (3,)
        Planar parameters (x, y, theta) [m, m, rad].
    distance, angle : float
        How far the centre of mass moves [m], and how far the object turns [rad], from the measured pose to this one.
    motion : float
        How far the object's points move, root mean square [m].
    label : str
        The pose as the command line takes it.
    inside : bool
        Whether it is within the workspace of its support.
    runner_up : RestingPose or None
        The nearest one in another placement, or on another support.
    """

    T: FloatArray
    support: str
    placement: int
    xi: FloatArray
    distance: float
    angle: float
    motion: float
    label: str
    inside: bool = True
    runner_up: RestingPose | None = None

    @property
    def away(self) -> str:
        """How far the measured pose is, in words."""
        return in_words(self.distance, self.angle)

    def within(self, tolerance: tuple[float, float]) -> bool:
        """Return whether the measured pose is within `tolerance` ([m], [rad])."""
        return self.distance <= tolerance[0] and self.angle <= tolerance[1]


def nearest_rests(T: FloatArray, body: ObjectModel, rests: Rests) -> list[RestingPose]:
    """Return the resting pose nearest to `T` (4, 4) of each of the `rests`, the nearest first."""
    mesh, planar = body.mesh, rests.planar
    middle = np.array(mesh.center_mass)
    inertia = mesh.moment_inertia / mesh.mass
    covariance = np.trace(inertia) / 2 * np.eye(3) - inertia
    seen = invert(planar.surfaces) @ T
    R = planar.bases[:, :3, :3] @ covariance @ seen[:, :3, :3].transpose(0, 2, 1)
    yaw = np.arctan2(R[:, 0, 1] - R[:, 1, 0], R[:, 0, 0] + R[:, 1, 1]).clip(planar.low[:, 2], planar.high[:, 2])
    turned = planar_transform(np.stack([0 * yaw, 0 * yaw, yaw], axis=-1)) @ planar.bases
    shift = (_moved(seen, middle) - _moved(turned, middle))[:, :2]
    held = np.isfinite(planar.high[:, 2])
    shift[held] = shift[held].clip(planar.low[held, :2], planar.high[held, :2])
    xi = np.column_stack([shift, yaw])
    poses = planar.at(np.arange(len(rests)), xi)
    rotated = np.einsum("sij,jk,ik->s", poses[:, :3, :3], covariance, T[:3, :3])
    squares = ((_moved(poses, middle) - _moved(T, middle)) ** 2).sum(axis=1) + 2 * (np.trace(covariance) - rotated)
    distance = np.linalg.norm(_moved(poses, body.center_of_mass) - _moved(T, body.center_of_mass), axis=1)
    angle = rotation_angle(poses[:, :3, :3].transpose(0, 2, 1) @ T[:3, :3])
    motion = np.sqrt(squares.clip(min=0))
    inside: BoolArray = np.all((xi >= planar.low - _ROUNDING) & (xi <= planar.high + _ROUNDING), axis=1)
    found = []
    for k in np.argsort(motion, kind="stable").tolist():
        support, number = rests[k]
        off = distance[k].item(), angle[k].item(), motion[k].item()
        found.append(RestingPose(poses[k], support.name, number, xi[k], *off, rests.text(k, xi[k]), bool(inside[k])))
    return found


def within_tolerance(found: list[RestingPose], tolerance: tuple[float, float]) -> list[RestingPose]:
    """Return those of `found` within `tolerance` ([m], [rad]); if some are in their workspace, only these.

    The plane of a board goes on where another board is.
    """
    near = [rest for rest in found if rest.within(tolerance)]
    return [rest for rest in near if rest.inside] or near


def rest_within(found: list[RestingPose], tolerance: tuple[float, float], name: str) -> RestingPose:
    """Return the first of `found`, which are sorted, that is within `tolerance`, with its runner-up.

    Raises
    ------
    PoseError
        If none is within `tolerance` ([m], [rad]), or two are; `name` is that of the measured pose.
    """
    if not found:
        raise PoseError(f"the {name} is on nothing: the object has no resting pose in this workcell")
    near = within_tolerance(found, tolerance)
    limit = f"{tolerance[0] * 1e3:g} mm and {math.degrees(tolerance[1]):g} degrees"
    if not near:
        raise PoseError(
            f"the {name} is not at rest: the nearest resting pose is {found[0].label}, "
            f"{found[0].away} away, and the tolerance is {limit}"
        )
    first = near[0]
    if len(near) > 1 and first.motion > EXACT:
        raise PoseError(
            f"the {name} is ambiguous: it is {first.away} from {first.label}, and {near[1].away} "
            f"from {near[1].label}, both within {limit}; measure it again or lower the tolerance"
        )
    return replace(first, runner_up=next((rest for rest in found if rest is not first), None))


def as_tolerance(tolerance: Any) -> tuple[float, float]:
    """Return `tolerance` as a distance [m] and an angle [rad].

    Raises
    ------
    OptionError
        If it is not two numbers that are at least 0.
    """
    try:
        distance, angle = (float(value) for value in tolerance)
    except (TypeError, ValueError):
        distance = angle = math.nan
    if not (distance >= 0 and angle >= 0):
        raise OptionError(f"tolerance is {tolerance}; give a distance [m] and an angle [rad], both at least 0")
    return distance, angle


def in_words(distance: float, angle: float) -> str:
    """Return a distance [m] and an angle [rad] in millimetres and degrees."""
    return f"{distance * 1e3:.1f} mm and {math.degrees(angle):.1f} degrees"


def _moved(T: FloatArray, point: FloatArray) -> FloatArray:
    """Return where `point` (3,) is in the poses `T` (..., 4, 4)."""
    moved: FloatArray = T[..., :3, :3] @ point + T[..., :3, 3]
    return moved
