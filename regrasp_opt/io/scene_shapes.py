"""Shapes that enclose those that an obstacle cannot have, and the word about what is enclosed or left out."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from regrasp_opt.conventions import FloatArray
from regrasp_opt.geometry.shapes import Mesh

NAMED = 3
"""Shapes that a warning names."""

SIDES = 64
"""Sides of the pyramid around a cone."""

SUBDIVISIONS = 3
"""Times that an icosahedron is refined to enclose a sphere; its corners then stand out by 0.5 % of the radius."""

ENCLOSED = "enclosed by a mesh, since an obstacle is a box, a cylinder or a mesh"

logger = logging.getLogger(__name__)


def say_left_out(path: Path, names: Sequence[str], why: str) -> None:
    """Warn that what has these names is left out, or enclosed, if there is any."""
    if names:
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        named = ", ".join(f"'{name}'" for name in names[:NAMED])
        logger.warning("%s: %s: %s%s", path, why, named, more)


def ball_around(name: str, radii: float | FloatArray, pose: FloatArray, half_length: float = 0.0) -> Mesh:
    """Return a mesh around a sphere, an ellipsoid of semi-axes `radii` (3,), or a capsule along z.

    Parameters
    ----------
    half_length : float
        Half the distance between the middles of a capsule's ends [m].
    """
    ball = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS)
    nearest = np.einsum("fi,fi->f", ball.triangles[:, 0], ball.face_normals).min()  # of its faces to its middle
    points = np.array(ball.vertices) / nearest * radii
    end = np.array([0.0, 0.0, half_length])
    return _hull(name, np.concatenate([points + end, points - end]) if half_length else points, pose)


def cone_around(name: str, radius: float, height: float, pose: FloatArray) -> Mesh:
    """Return a pyramid around a cone along z, its middle at half its height."""
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    rim = radius / np.cos(np.pi / SIDES) * np.column_stack([np.cos(angle), np.sin(angle)])
    foot = np.column_stack([rim, np.full(SIDES, -height / 2)])
    return _hull(name, np.concatenate([foot, [[0.0, 0.0, height / 2]]]), pose)


def _hull(name: str, points: FloatArray, pose: FloatArray) -> Mesh:
    """Return the convex hull of `points` (P, 3) in the frame `pose` (4, 4)."""
    hull = trimesh.convex.convex_hull(points)
    return Mesh(name, np.array(hull.vertices, dtype=np.float64), np.array(hull.faces, dtype=np.int64), pose)
