"""The robot: joints and limits, forward and inverse kinematics, and the bodies that can collide.

Everything is in the frame of the URDF's root link (base) and the configuration of the joints that lead to
the tip.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from regrasp_opt.conventions import JOINT_LIMIT_TOLERANCE, FloatArray
from regrasp_opt.files import content_hash
from regrasp_opt.robots.ik import IkSolutions, InverseKinematics
from regrasp_opt.robots.kinematics import SerialChain
from regrasp_opt.robots.queries import settle_queries
from regrasp_opt.robots.self_test import IkTest, self_test


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial arm on a fixed base, as `load_robot` makes it.

    Attributes
    ----------
    name : str
        Built-in name, or the name in the URDF.
    urdf_path : str
        The file it was read from.
    model : pin.Model
        Pinocchio model of the joints from base to tip; all others are locked. ``nq == nv == dof``.
    collision : pin.GeometryModel
        Collision bodies of all links, without collision pairs.
    tip_frame : str
        Link at the tip, a frame of `model`; tools are mounted on it, along +z.
    chain : SerialChain
        The same joints for batches of configurations.
    ik : InverseKinematics
        Analytic where that finds the arm's own configurations, else numerical; see `ik_test`.
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
    model: pin.Model
    collision: pin.GeometryModel
    tip_frame: str
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

    @cached_property
    def max_reach(self) -> float:
        """Upper bound on the distance from the base origin to the tip [m]."""
        return self.chain.reach(self.lower, self.upper)

    @cached_property
    def ik_test(self) -> IkTest:
        """How the inverse kinematics does on configurations of this arm; a numerical one takes about 0.1 s for it."""
        return self_test(self.ik, self.chain, self.lower, self.upper)

    def forward(self, q: ArrayLike) -> FloatArray:
        """Return ``T_base_tip`` (..., 4, 4) at configurations `q` (..., dof)."""
        return self.chain.forward(q)

    def link_transforms(self, q: ArrayLike) -> FloatArray:
        """Return the poses (..., dof, 4, 4) of all joint frames in the base frame at `q` (..., dof)."""
        return self.chain.link_transforms(q)

    def solve_ik(self, T_base_tip: ArrayLike) -> IkSolutions:
        """Return configurations within limits that put the tip at poses (B, 4, 4), or at one pose (4, 4).

        With an analytic solver these are all branches, each turning joint at its value nearest to 0 that
        lies within its limits; `equivalents` gives the others. With a numerical one they are those that its
        starts reach. Every one reproduces its pose to `FK_POSITION_TOLERANCE` and `FK_ROTATION_TOLERANCE`.
        """
        return self.ik.solve(np.asarray(T_base_tip, dtype=np.float64).reshape(-1, 4, 4))

    def equivalents(self, q: ArrayLike) -> FloatArray:
        """Return the configurations (K, dof) within limits that differ from `q` (dof,) by whole turns."""
        q = np.asarray(q, dtype=np.float64)
        low = np.ceil((self.lower - JOINT_LIMIT_TOLERANCE - q) / math.tau)
        high = np.floor((self.upper + JOINT_LIMIT_TOLERANCE - q) / math.tau)
        values = [
            [x] if slides else [x + math.tau * k for k in np.arange(a, b + 1)]
            for x, slides, a, b in zip(q, self.chain.prismatic, low, high, strict=True)
        ]
        return np.array(list(product(*values))).reshape(-1, self.dof)

    def within_limits(self, q: ArrayLike) -> bool:
        """Return whether all joints of `q` (dof,) stand within their limits."""
        q = np.asarray(q, dtype=np.float64)
        low, high = self.lower - JOINT_LIMIT_TOLERANCE, self.upper + JOINT_LIMIT_TOLERANCE
        return bool(((q >= low) & (q <= high)).all())

    def link_of(self, geometry: int) -> str:
        """Return the name of the link that carries the collision body of index `geometry`."""
        return str(self.model.frames[self.collision.geometryObjects[geometry].parentFrame].name)

    def self_collision_pairs(self) -> list[tuple[int, int]]:
        """Return index pairs of collision bodies to test against each other.

        All pairs on different joints that are not neighbours in the chain, less the `ignored` pairs of links.
        """
        joints = [geometry.parentJoint for geometry in self.collision.geometryObjects]
        links = [self.link_of(index) for index in range(len(joints))]
        return [
            (i, j)
            for i in range(len(joints))
            for j in range(i + 1, len(joints))
            if abs(joints[i] - joints[j]) > 1 and frozenset((links[i], links[j])) not in self.ignored
        ]

    def colliding_links(self, q: ArrayLike) -> tuple[str, str] | None:
        """Return the first two links that collide with each other at `q` (dof,), or None."""
        geometry = self.collision.copy()
        pairs = self.self_collision_pairs()
        for i, j in pairs:
            geometry.addCollisionPair(pin.CollisionPair(i, j))
        data = geometry.createData()
        settle_queries(data, np.zeros(len(pairs)))
        q = np.asarray(q, dtype=np.float64)
        if not pin.computeCollisions(self.model, self.model.createData(), geometry, data, q, False):
            return None
        hit = next(k for k, result in enumerate(data.collisionResults) if result.isCollision())
        return self.link_of(pairs[hit][0]), self.link_of(pairs[hit][1])

    def fingerprint(self) -> str:
        """Return a hash of what decides feasibility: joints, limits, collision bodies and tested pairs."""
        chain = self.chain
        bodies = [
            [body.parentJoint, body.placement.homogeneous, _shape_parts(body.geometry)]
            for body in self.collision.geometryObjects
        ]
        joints = [chain.placements, chain.axes, chain.prismatic, chain.tip, self.lower, self.upper]
        return content_hash("robot", joints, bodies, self.self_collision_pairs())


def _shape_parts(shape: Any) -> list[Any]:
    """Return the numbers that make up a Coal shape."""
    kind = type(shape).__name__
    if isinstance(shape, coal.Box):
        return [kind, np.array(shape.halfSide)]
    if isinstance(shape, coal.Sphere):
        return [kind, float(shape.radius)]
    if isinstance(shape, (coal.Cylinder, coal.Capsule)):
        return [kind, float(shape.radius), float(shape.halfLength)]
    triangles = [shape.tri_indices(i) for i in range(shape.num_tris)]
    return [
        kind,
        np.array(shape.vertices()),
        np.array([[t[0], t[1], t[2]] for t in triangles], dtype=np.int64),
    ]
