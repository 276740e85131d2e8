"""The robot: joints and limits, forward and inverse kinematics, and the bodies that can collide.

Everything is in the frame of the URDF's root link (base) and the configuration of the joints that lead to
the tip.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from regrasp_opt.conventions import JOINT_LIMIT_TOLERANCE, BoolArray, FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.shapes import geometry_parts
from regrasp_opt.robots.analytic import AnalyticIk
from regrasp_opt.robots.ik import IkSolutions, InverseKinematics
from regrasp_opt.robots.kinematics import SerialChain
from regrasp_opt.robots.locked import LockedIk
from regrasp_opt.robots.self_test import IkTest, self_test
from regrasp_opt.robots.urdf import parse_xml


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial arm on a fixed base, as `load_robot` makes it.

    Attributes
    ----------
    name : str
        Built-in name, or the name in the URDF.
    urdf_path : str
        The file it was read from.
    urdf : bytes
        Its XML, with absolute mesh names.
    model : pin.Model
        Pinocchio model of the joints from base to tip; all others are locked. ``nq == nv == dof``.
    collision : pin.GeometryModel
        Collision bodies of all links, without collision pairs.
    tip_frame : str
        Link at the tip, a frame of `model`; tools are mounted on it, along +z.
    mount : str
        Link of the file that the tip is, or is fixed to.
    locked : dict
        Where the file's other joints are held, by name [rad, m].
    chain : SerialChain
        The same joints for batches of configurations.
    ik : InverseKinematics
        Analytic where that finds the arm's own configurations, of seven joints with one of them locked at sampled
        values; else numerical. See `ik_test`.
    lower, upper : (dof,) arrays
        Joint limits [rad, m]. A continuous joint has +-2 pi.
    velocity_limits : (dof,) array
        Largest joint speeds [rad/s, m/s].
    home : (dof,) array
        Where the arm rests, within limits [rad, m].
    ignored : frozenset
        Pairs of link names, each a frozenset, that are never tested against each other.
    rebuild : tuple
        Function and arguments that make this robot again, in another process.
    """

    name: str
    urdf_path: str
    urdf: bytes
    model: pin.Model
    collision: pin.GeometryModel
    tip_frame: str
    mount: str
    locked: dict[str, float]
    chain: SerialChain
    ik: InverseKinematics
    lower: FloatArray
    upper: FloatArray
    velocity_limits: FloatArray
    home: FloatArray
    ignored: frozenset[frozenset[str]]
    rebuild: tuple[Callable[..., Robot], tuple[Any, ...]] = field(repr=False)

    def __reduce__(self) -> tuple[Callable[..., Robot], tuple[Any, ...]]:
        """Pickle as the arguments it was made from: the compiled solver cannot travel between processes."""
        return self.rebuild

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.chain.dof

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, from the base to the tip."""
        return tuple(self.model.names)[1:]

    @property
    def T_mount_tip(self) -> FloatArray:
        """Where the tip is on the link `mount` (4, 4)."""
        mount, tip = (self.model.frames[self.model.getFrameId(f)].placement for f in (self.mount, self.tip_frame))
        seat: FloatArray = (mount.inverse() * tip).homogeneous
        return seat

    @cached_property
    def max_reach(self) -> float:
        """Upper bound on the distance from the base origin to the tip [m]."""
        return self.chain.reach(self.lower, self.upper)

    @cached_property
    def ik_test(self) -> IkTest:
        """How the inverse kinematics does on configurations of this arm; a numerical one takes up to 0.5 s for it."""
        return self_test(self.ik, self.chain, self.lower, self.upper)

    def forward(self, q: ArrayLike) -> FloatArray:
        """Return ``T_base_tip`` (..., 4, 4) at configurations `q` (..., dof)."""
        return self.chain.forward(q)

    def link_transforms(self, q: ArrayLike) -> FloatArray:
        """Return the poses (..., dof, 4, 4) of all joint frames in the base frame at `q` (..., dof)."""
        return self.chain.link_transforms(q)

    def solve_ik(self, T_base_tip: ArrayLike) -> IkSolutions:
        """Return configurations within limits that put the tip at poses (B, 4, 4), or at one pose (4, 4).

        With an analytic solver these are all branches, each turning joint at its value nearest to 0 that lies within
        its limits; `equivalents` gives the others. With seven joints they are those at the sampled values of one joint;
        with a numerical solver, those that its starts reach. Every one reproduces its pose to `FK_POSITION_TOLERANCE`
        and `FK_ROTATION_TOLERANCE`.
        """
        return self.ik.solve(np.asarray(T_base_tip, dtype=np.float64).reshape(-1, 4, 4))

    def solve_without_limits(self, T_base_tip: FloatArray) -> IkSolutions | None:
        """Return the configurations that would reach poses (B, 4, 4) but for the limits; None where that is not known.

        Turning joints are within half a turn of 0, a locked one keeps its samples. `beyond_limits` says which of them
        are the trouble.
        """
        return self.ik.without_limits().solve(T_base_tip) if isinstance(self.ik, (AnalyticIk, LockedIk)) else None

    def reaches(self, T_base_tip: FloatArray) -> BoolArray:
        """Return which poses (B, 4, 4) the tip could reach but for the limits; where that is not known, all."""
        reached = np.full(len(T_base_tip), not isinstance(self.ik, AnalyticIk))
        if isinstance(self.ik, AnalyticIk):
            reached[self.ik.without_limits().solve(T_base_tip).pose_index] = True
        return reached

    def beyond_limits(self, q: FloatArray) -> BoolArray:
        """Return which joints of configurations `q` (..., dof) no number of whole turns brings within their limits."""
        fewest, most = self._turns(q)
        outside = (q < self.lower - JOINT_LIMIT_TOLERANCE) | (q > self.upper + JOINT_LIMIT_TOLERANCE)
        beyond: BoolArray = np.where(self.chain.prismatic, outside, fewest > most)
        return beyond

    def equivalents(self, q: ArrayLike) -> list[FloatArray]:
        """Return for each joint its values (K,) within limits that differ from that of `q` (dof,) by whole turns."""
        q = np.asarray(q, dtype=np.float64)
        return [x + math.tau * np.arange(a, b + 1) for x, a, b in zip(q, *self._turns(q), strict=True)]

    def nearest_equivalent(self, q: ArrayLike, to: ArrayLike) -> FloatArray:
        """Return `q` (..., dof) moved by whole turns within limits, each joint as near to that of `to` as can be."""
        q, to = np.asarray(q, dtype=np.float64), np.asarray(to, dtype=np.float64)
        moved: FloatArray = q + math.tau * np.clip(np.round((to - q) / math.tau), *self._turns(q))
        return moved

    def _turns(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least and the most whole turns that can be added to `q` (..., dof)."""
        low = np.ceil((self.lower - JOINT_LIMIT_TOLERANCE - q) / math.tau)
        high = np.floor((self.upper + JOINT_LIMIT_TOLERANCE - q) / math.tau)
        turning = ~self.chain.prismatic
        return low * turning, high * turning

    def within_limits(self, q: ArrayLike) -> bool:
        """Return whether all joints of `q` (dof,) stand within their limits."""
        q = np.asarray(q, dtype=np.float64)
        low, high = self.lower - JOINT_LIMIT_TOLERANCE, self.upper + JOINT_LIMIT_TOLERANCE
        return bool(((q >= low) & (q <= high)).all())

    def configuration(self, q: ArrayLike, name: str) -> FloatArray:
        """Return `q`, which a message calls `name`, as an array (dof,).

        Raises
        ------
        OptionError
            If it is not a configuration within the joint limits.
        """
        try:
            found = np.array(q, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise OptionError(f"{name} must be {self.dof} joint values") from error
        if found.shape != (self.dof,) or not self.within_limits(found):
            raise OptionError(
                f"{name} is {np.round(found, 3).tolist()}; give {self.dof} joint values within their limits"
            )
        return found

    def link_of(self, geometry: int) -> str:
        """Return the name of the link that carries the collision body of index `geometry`."""
        return str(self.model.frames[self.collision.geometryObjects[geometry].parentFrame].name)

    @cached_property
    def neighbours(self) -> tuple[frozenset[str], ...]:
        """The two links that each joint connects, from the base to the tip."""
        frames = self.model.frames
        joints = [i for i, frame in enumerate(frames) if frame.type == pin.FrameType.JOINT]
        moved = {frame.parentFrame: frame.name for frame in frames if frame.type == pin.FrameType.BODY}
        return tuple(frozenset((frames[frames[j].parentFrame].name, moved[j])) for j in joints)

    @cached_property
    def obstacles(self) -> frozenset[int]:
        """Indices of the bodies that stand still, but for those of the link in which the first joint turns."""
        items = self.collision.geometryObjects
        return frozenset(
            i for i, item in enumerate(items) if item.parentJoint == 0 and self.link_of(i) not in self.neighbours[0]
        )

    def links_without_body(self) -> list[str]:
        """Return the links that move and have no body: those that are seen, and those after a joint that moves none."""
        frames, solid = self.model.frames, {self.link_of(index) for index in range(self.collision.ngeoms)}
        seen = {link.get("name") for link in parse_xml(self.urdf).iterfind("link[visual]")}
        filled = {item.parentJoint for item in self.collision.geometryObjects}
        links = [frame for frame in frames if frame.type == pin.FrameType.BODY and frame.parentJoint]
        first = {f.name for f in links if frames[f.parentFrame].type == pin.FrameType.JOINT}
        bare = [f for f in links if f.name not in solid]
        return [f.name for f in bare if f.name in seen or (f.name in first and f.parentJoint not in filled)]

    def self_collision_pairs(self) -> list[tuple[int, int]]:
        """Return index pairs of collision bodies to test against each other.

        All that move with different joints, less those of links which one joint connects and of the `ignored` links.
        """
        joints = [geometry.parentJoint for geometry in self.collision.geometryObjects]
        links = [self.link_of(index) for index in range(len(joints))]
        untested = {*self.neighbours, *self.ignored}
        return [
            (i, j)
            for i in range(len(joints))
            for j in range(i + 1, len(joints))
            if joints[i] != joints[j] and frozenset((links[i], links[j])) not in untested
        ]

    def fingerprint(self) -> str:
        """Return a hash of what decides feasibility: joints, limits, collision bodies and tested pairs."""
        chain = self.chain
        bodies = [
            [body.parentJoint, body.placement.homogeneous, geometry_parts(body.geometry)]
            for body in self.collision.geometryObjects
        ]
        joints = [chain.placements, chain.axes, chain.prismatic, chain.tip, self.lower, self.upper]
        return content_hash("robot", joints, bodies, self.self_collision_pairs())
