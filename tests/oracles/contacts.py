"""Whether a grasp holds: pads that meet the object where they close, or a cup that lies on it."""

from __future__ import annotations

import numpy as np

FRICTION = 0.5
ANGLE = np.arctan(FRICTION) + np.deg2rad(1.0)
"""Largest angle between the closing direction and the surface at a contact [rad]."""
INSIDE, OUTSIDE = 2.1e-3, 1.1e-3
"""How far beyond the pad's face a contact may lie, or before it [m]: soft pads close on bumps and hollows."""
RAYS, FINE = 15, 401
"""Rays along each edge of a pad, and along its middle line: thin objects meet no more than a fingertip."""
SEAL_DEPTH, SEAL_ANGLE = 0.5, np.deg2rad(55.0)
"""How far from the cup's rim plane the surface may be, in radii, and how it may lean: the softest cup."""


def hold_problem(tool, solid, T_object_tcp, width):
    """Return why a grasp (4, 4) of an opening `width` [m] does not hold the mesh `solid`, or None."""
    return (_jaw if tool.kind == "parallel" else _cup)(tool, solid, np.asarray(T_object_tcp, dtype=float), width)


def _jaw(tool, solid, T, width):
    if not 0 < width <= tool.max_opening:
        return f"the jaw cannot be {width:.4f} m open"
    for sign, side in ((1.0, "+"), (-1.0, "-")):
        if not _touches(solid, T, tool.pad - [0, tool.tcp_offset], sign, width):
            return f"the {side}y finger touches nothing that it could hold"
    return None


def _touches(solid, T, pad, sign, width):
    """Return whether the surface meets a pad, (low, high) in x and z of the TCP frame, at an opening of `width` [m]."""
    x, z = (np.append(np.linspace(*ends, RAYS), np.clip(0.0, *ends)) for ends in pad.T)
    middle = np.linspace(*pad[:, 1], FINE)
    grids = [np.meshgrid(*lines, indexing="ij") for lines in ((x, [0.0], z), ([0.0], [0.0], middle))]
    spots = np.concatenate([np.stack(grid, axis=-1).reshape(-1, 3) for grid in grids])
    direction = sign * T[:3, 1]
    _, y, triangle = solid.hits(spots @ T[:3, :3].T + T[:3, 3], direction)
    facing = solid.normals[triangle] @ direction >= np.cos(ANGLE)
    face = width / 2
    return bool((facing & (y > face - INSIDE) & (y < face + OUTSIDE)).any())


def _cup(tool, solid, T, _):
    turns, radius = np.arange(24) * np.pi / 12, tool.cup_radius
    rings = [[(0.0, 0.0)], *([(s * radius * np.cos(a), s * radius * np.sin(a)) for a in turns] for s in (0.5, 1.0))]
    spots = np.array([(x, y, -radius) for ring in rings for x, y in ring])
    ray, depth, triangle = solid.hits(spots @ T[:3, :3].T + T[:3, 3], T[:3, 2])
    for n in range(len(spots)):
        mine = np.flatnonzero((ray == n) & (depth > 0))
        if len(mine) == 0:
            return "the cup lies over nothing"
        first = mine[np.argmin(depth[mine])]
        if abs(depth[first] - radius) > SEAL_DEPTH * radius:
            return f"the cup's rim is {depth[first] - radius:.4f} m off the surface"
        if solid.normals[triangle[first]] @ T[:3, 2] > -np.cos(SEAL_ANGLE):
            return "the surface leans away from the cup"
    return None
