"""The four built-in objects: bottle, mug, pentagonal prism and figurine, made from primitives [m].

Each stands on z = 0 with its axis along z, fits a jaw of 0.104 m, and is watertight.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from trimesh.transformations import rotation_matrix

from regrasp_opt.conventions import FloatArray

OBJECT_NAMES = ("bottle", "mug", "pentagon", "figurine")
"""The built-in objects."""


def build(name: str) -> trimesh.Trimesh:
    """Return the mesh of the built-in object `name` in metres, the same every time.

    Vertices are rounded to a micrometre, because booleans in single precision leave noise just below that.
    """
    builders: dict[str, Callable[[], trimesh.Trimesh]] = {
        "bottle": bottle,
        "mug": mug,
        "pentagon": pentagon,
        "figurine": figurine,
    }
    mesh = builders[name]()
    return trimesh.Trimesh(np.round(mesh.vertices, 6), mesh.faces, process=False)


def bottle(width: float = 0.06, height: float = 0.20, corner: float = 0.014) -> trimesh.Trimesh:
    """Return a bottle with a square body of rounded corners, a shoulder, a neck and a cap.

    It stands on its base and lies on each flat side; the cap is too narrow to stand on.
    """
    body_top, shoulder_top = 0.62 * height, 0.76 * height
    body, neck = _rounded_square(width, corner), _circle(0.010)
    return _union(
        _hull(_at_height(body, 0.0), _at_height(body, body_top)),
        _hull(
            _at_height(body, body_top - 0.001),
            _at_height(body, body_top),
            _at_height(neck, shoulder_top),
        ),
        _prism(neck, shoulder_top - 0.01, height - 0.02),
        _prism(_circle(0.0115), height - 0.022, height),
    )


def mug(radius: float = 0.04, height: float = 0.09, wall: float = 0.0045) -> trimesh.Trimesh:
    """Return a round mug with an open inside and a ring handle on its +x side."""
    handle = trimesh.creation.torus(major_radius=0.026, minor_radius=0.0055, major_sections=32, minor_sections=12)
    handle.apply_transform(rotation_matrix(np.pi / 2, [1, 0, 0]))
    handle.apply_translation([radius - 0.003, 0.0, 0.5 * height])
    solid = _union(_prism(_circle(radius, 48), 0.0, height), handle)
    return _difference(solid, _prism(_circle(radius - wall, 48), 0.006, height + 0.01))


def pentagon(circumradius: float = 0.05, thickness: float = 0.03) -> trimesh.Trimesh:
    """Return a regular pentagonal prism; it rests on its two faces and its five sides."""
    return _prism(_circle(circumradius, 5), 0.0, thickness)


def figurine() -> trimesh.Trimesh:
    """Return a sitting rabbit about 0.1 m tall: body, head, ears, paws and a tail, cut flat below."""
    parts = [
        _ellipsoid((0.0, 0.0, 0.030), (0.034, 0.027, 0.032), 3),
        _ellipsoid((0.024, 0.0, 0.062), (0.021, 0.019, 0.018)),
        _ellipsoid((-0.035, 0.0, 0.022), (0.009, 0.009, 0.009), 1),
    ]
    for side in (-1.0, 1.0):
        parts += [
            _ellipsoid((0.012, side * 0.011, 0.085), (0.0055, 0.0065, 0.019), 1),
            _ellipsoid((0.026, side * 0.013, 0.004), (0.014, 0.009, 0.009), 1),
            _ellipsoid((-0.012, side * 0.022, 0.008), (0.020, 0.010, 0.014), 1),
        ]
    below = trimesh.creation.box(bounds=[[-0.2, -0.2, -0.1], [0.2, 0.2, 0.0]])
    return _difference(_union(*parts), below)


def _circle(radius: float, sections: int = 32) -> FloatArray:
    angle = 2 * np.pi * np.arange(sections) / sections
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _rounded_square(width: float, corner: float, sections: int = 6) -> FloatArray:
    angle = np.pi / 2 * np.arange(sections + 1) / sections
    arc = width / 2 - corner + corner * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.concatenate([arc @ np.linalg.matrix_power(quarter, turn).T for turn in range(4)])


def _at_height(outline: FloatArray, z: float) -> FloatArray:
    return np.column_stack([outline, np.full(len(outline), z)])


def _hull(*points: FloatArray) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(np.concatenate(points))


def _prism(outline: FloatArray, low: float, high: float) -> trimesh.Trimesh:
    return _hull(_at_height(outline, low), _at_height(outline, high))


def _ellipsoid(
    center: tuple[float, float, float], semi_axes: tuple[float, float, float], subdivisions: int = 2
) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    return trimesh.Trimesh(ball.vertices * semi_axes + center, ball.faces, process=False)


def _union(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.union(list(parts), engine="manifold")


def _difference(solid: trimesh.Trimesh, tool: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.difference([solid, tool], engine="manifold")
