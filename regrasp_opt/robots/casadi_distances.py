"""Distances between spheres, capsules, boxes and planes as CasADi expressions, for clearance constraints.

A capsule is a segment with a radius; a sphere is a capsule whose segment is a point. The nearest points of two
segments are found by clamping (Ericson, Real-Time Collision Detection, 2005, section 5.1.9).

How smooth they are: the squared distance of two convex sets is once continuously differentiable wherever their
nearest points are unique, and automatic differentiation through the clamps gives exactly that gradient, because each
clamped parameter is either constant or optimal. It jumps where overlapping segments are parallel, and second
derivatives jump where a nearest point passes an end. Square roots are rounded off by `ROUNDING`, so that gradients
stay finite at contact. Interior-point solvers bear all three. Tests hold the values to Coal.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

ROUNDING = 1e-6
"""Distances d are replaced by ``sqrt(d^2 + ROUNDING^2)`` [m]: 1e-6 too large at contact, 1e-10 at 5 mm."""

_PARALLEL = 1e-12
"""Squared sine of the angle between segments, times their squared lengths, below which they count as parallel."""


def capsule_distance(a: Any, b: Any, radius_ab: Any, c: Any, d: Any, radius_cd: Any) -> Any:
    """Return the distance of two capsules [m]; negative by the depth to which their segments are inside each other.

    Parameters
    ----------
    a, b : (3,)
        Ends of the first segment [m]; equal for a sphere.
    radius_ab : float or expression
        Its radius [m].
    c, d, radius_cd
        The second capsule.
    """
    return ca.sqrt(segment_squared_distance(a, b, c, d) + ROUNDING**2) - radius_ab - radius_cd


def segment_squared_distance(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return the squared distance [m^2] of the segments from `a` to `b` and from `c` to `d` (3,)."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = ca.dot(u, u), ca.dot(u, v), ca.dot(v, v)
    uw, vw = ca.dot(u, w), ca.dot(v, w)
    s = _clamp((uv * vw - uw * vv) / (uu * vv - uv * uv + _PARALLEL))
    t = _clamp((uv * s + vw) / (vv + _PARALLEL))
    s = _clamp((uv * t - uw) / (uu + _PARALLEL))
    return ca.sumsqr(w + s * u - t * v)


def point_box_distance(p: Any, half: Any) -> Any:
    """Return the signed distance [m] of `p` (3,), in the box's frame, to a box of half edge lengths `half` (3,)."""
    beyond = ca.fabs(p) - half
    outside = ca.sqrt(ca.sumsqr(ca.fmax(beyond, 0)) + ROUNDING**2)
    return outside + ca.fmin(ca.mmax(beyond), 0)


def _clamp(x: Any) -> Any:
    return ca.fmin(ca.fmax(x, 0), 1)
