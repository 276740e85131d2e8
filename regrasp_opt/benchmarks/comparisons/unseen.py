"""Meshes and obstacles that nothing was prepared for, built here [m], the same for the same seed.

The meshes are six families of nine: what a jaw of 0.104 m can hold, mostly; some are too flat, too round or too wide
for any plan, as real files are. Obstacles are boxes, cylinders and such meshes that stand on the table.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh
from trimesh.creation import box, cone, icosphere, torus
from trimesh.transformations import rotation_matrix

from regrasp_opt.conventions import FloatArray, planar_transform
from regrasp_opt.conventions import translation as at
from regrasp_opt.errors import WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.planning import RegraspProblem

Rng = np.random.Generator
VARIANTS = 9
"""Meshes of a family."""
FEWEST, MOST = 3, 12
"""Obstacles of a scene."""


def made_meshes(count: int, seed: int) -> dict[str, trimesh.Trimesh]:
    """Return the first `count` meshes by name, families in turn; at most ``VARIANTS`` of each.

    Every mesh has random numbers of its own, so it does not depend on `count`.
    """
    found: dict[str, trimesh.Trimesh] = {}
    for number in range(min(count, VARIANTS * len(FAMILIES))):
        variant, family = divmod(number, len(FAMILIES))
        name, build = list(FAMILIES.items())[family]
        if build is thin:
            name = f"{name}-{list(thin_things())[variant]}"
        mesh = build(variant, np.random.default_rng([seed, family, variant]))
        found[f"{name}-{variant}"] = trimesh.Trimesh(np.round(mesh.vertices, 6), mesh.faces)
    return found


def superquadric(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a superquadric with a flat foot: 1,280, 5,120 or 20,480 faces before the foot is cut."""
    axes, (e1, e2) = rng.uniform(0.02, 0.06, 3), rng.uniform(0.2, 1.0, 2)
    ball = icosphere(subdivisions=(3, 5, 4)[variant % 3])
    u = np.abs(ball.vertices / axes)
    radius = ((u[:, 0] ** (2 / e2) + u[:, 1] ** (2 / e2)) ** (e2 / e1) + u[:, 2] ** (2 / e1)) ** (-e1 / 2)
    return _cut(trimesh.Trimesh(ball.vertices * radius[:, None], ball.faces), -0.7 * axes[2])


def constructed(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a block with another block or a peg on it, and a hole through it."""
    size = rng.uniform(0.03, 0.09, 3)
    parts = [box(size)]
    for _ in range(1 + variant % 3):
        place = rng.uniform(-0.5, 0.5, 3) * size
        if rng.random() < 0.5:
            parts.append(box(rng.uniform(0.02, 0.07, 3), at(*place)))
        else:
            parts.append(_peg(rng.uniform(0.008, 0.025), rng.uniform(0.04, 0.12), at(*place)))
    turned = rotation_matrix(np.pi / 2 * rng.integers(2), [1, 0, 0])
    return _without(_union(*parts), _peg(rng.uniform(0.004, 0.012), 0.4).apply_transform(turned))


@cache
def thin_things() -> dict[str, trimesh.Trimesh]:
    """Return thin things that people pick up, by name, 24 mm to 20 cm long and 2.5 to 12 mm thick, mostly."""
    wrench = _union(
        box([0.15, 0.014, 0.006]), _peg(0.018, 0.006, at(-0.075, 0, 0)), _peg(0.015, 0.006, at(0.075, 0, 0))
    )
    handle = _without(_peg(0.016, 0.005, at(-0.07, 0, 0)), _peg(0.011, 0.02, at(-0.07, 0, 0)))
    blade = _union(handle, box([0.14, 0.009, 0.005], at(0.015, 0, 0)))
    head = _without(_peg(0.012, 0.0025), _peg(0.004, 0.02))
    bowl = icosphere(subdivisions=4).apply_transform(np.diag([0.03, 0.02, 0.01, 1.0]))
    hollow = icosphere(subdivisions=4).apply_transform(at(0, 0, 0.003) @ np.diag([0.027, 0.017, 0.01, 1.0]))
    return {
        "plate": box([0.20, 0.15, 0.006]),
        "ring": torus(0.0105, 0.0015, major_sections=48, minor_sections=16),
        "screwdriver": _union(_peg(0.014, 0.1, at(0, 0, -0.05)), _peg(0.003, 0.11, at(0, 0, 0.045))),
        "wrench": _without(wrench, box([0.03, 0.016, 0.02], at(-0.09, 0, 0)), _peg(0.008, 0.02, at(0.075, 0, 0))),
        "scissors": _union(*(blade.copy().apply_transform(rotation_matrix(a, [0, 0, 1])) for a in (-0.28, 0.28))),
        "key": _union(head, box([0.042, 0.008, 0.0025], at(0.03, 0, 0))),
        "ruler": box([0.20, 0.025, 0.003]),
        "spoon": _cut(_union(_without(bowl, hollow), box([0.13, 0.01, 0.004], at(0.09, 0, 0))), -0.007),
        "disc": _peg(0.04, 0.012),
    }


def thin(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return one of the thin things, in their order."""
    return list(thin_things().values())[variant]


def handled(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a can, a block or a cup with a ring handle at its side or on top."""
    radius, height = rng.uniform(0.025, 0.045), rng.uniform(0.05, 0.11)
    body = box([2 * radius, 2 * radius, height]) if variant % 3 == 1 else _peg(radius, height)
    handle = torus(rng.uniform(0.02, 0.03), rng.uniform(0.004, 0.007), major_sections=48, minor_sections=16)
    side = at(radius - 0.002, 0, 0) if variant % 2 == 0 else at(0, 0, height / 2)
    whole = _union(body, handle.apply_transform(side @ rotation_matrix(np.pi / 2, [1, 0, 0])))
    return _without(whole, _peg(radius - 0.004, height, at(0, 0, 0.006))) if variant % 3 == 2 else whole


def shell(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a bowl, a cup, a tube, an open tray or a dome, with walls of 3 to 5 mm."""
    radius, height, wall = rng.uniform(0.03, 0.06), rng.uniform(0.05, 0.1), rng.uniform(0.003, 0.005)
    kind = variant % 5
    if kind == 0:
        ball = icosphere(subdivisions=5 if variant else 4)
        bowl = _without(ball.copy().apply_scale(radius), ball.copy().apply_scale(radius - wall))
        return _cut(_without(bowl, box([1, 1, 1], at(0, 0, 0.5 + 0.3 * radius))), -0.97 * radius)
    if kind == 3:
        size = np.array([2 * radius, 1.4 * radius, 0.6 * height])
        return _without(box(size), box(size - [2 * wall, 2 * wall, 0], at(0, 0, wall)))
    if kind == 4:
        ball = icosphere(subdivisions=4)
        return _cut(_without(ball.copy().apply_scale(radius), ball.copy().apply_scale(radius - wall)), 0.0)
    bottom = 2 * wall if kind == 1 else -height
    return _without(_peg(radius, height), _peg(radius - wall, 1.5 * height, at(0, 0, height / 4 + bottom)))


def coarse(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a convex body of few faces: the hull of some points, a wedge, or a pyramid's stump."""
    if variant % 3 == 1:
        x, y, z = rng.uniform(0.03, 0.09, 3)
        wedge = [(0, 0, 0), (x, 0, 0), (0, y, 0), (x, y, 0), (0, 0, z), (0, y, z)]
        return trimesh.convex.convex_hull(np.array(wedge))
    if variant % 3 == 2:
        return _without(cone(0.045, 0.12, sections=4 + variant), box([1, 1, 1], at(0, 0, 0.5 + rng.uniform(0.05, 0.1))))
    points = rng.normal(size=(8 + variant, 3))
    spread = rng.uniform(0.02, 0.05, 3)
    return trimesh.convex.convex_hull(points / np.linalg.norm(points, axis=1, keepdims=True) * spread)


FAMILIES: dict[str, Callable[[int, Rng], trimesh.Trimesh]] = {
    each.__name__: each for each in (superquadric, thin, constructed, shell, handled, coarse)
}


def random_scene(problem: RegraspProblem, rng: np.random.Generator) -> list[Shape]:
    """Return `FEWEST` to `MOST` obstacles around the workspace of `problem`, none of which the robot at home is in."""
    low, high = problem.workcell.bounds.array
    wanted, found = int(rng.integers(FEWEST, MOST + 1)), list[Shape]()
    while len(found) < wanted:
        spot = np.append(rng.uniform(low - 0.05, high + 0.05), rng.uniform(0, 2 * np.pi))
        T = at(0, 0, problem.workcell.table.height) @ planar_transform(spot)
        shape = _random_shape(f"obstacle {len(found)}", T, rng)
        try:
            problem.with_obstacles([*found, shape])
        except WorkcellError:
            continue
        found.append(shape)
    return found


def _random_shape(name: str, T: FloatArray, rng: np.random.Generator) -> Shape:
    """Return a shape that stands at the pose `T` (4, 4)."""
    kind, height = int(rng.integers(3)), float(rng.uniform(0.04, 0.25))
    if kind == 0:
        return Box(name, np.array([*rng.uniform(0.04, 0.18, 2), height]), T @ at(0, 0, height / 2))
    if kind == 1:
        return Cylinder(name, float(rng.uniform(0.015, 0.06)), height, T @ at(0, 0, height / 2))
    mesh = constructed(int(rng.integers(VARIANTS)), rng)
    return Mesh(name, mesh.vertices, mesh.faces, T @ at(0, 0, -float(mesh.bounds[0, 2])))


def _peg(radius: float, height: float, T: FloatArray | None = None) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, height, sections=64, transform=T)


def _cut(solid: trimesh.Trimesh, z: float) -> trimesh.Trimesh:
    """Return the part of `solid` above the height `z`."""
    return _without(solid, box([1, 1, 1], at(0, 0, z - 0.5)))


def _union(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.union(list(parts), engine="manifold")


def _without(solid: trimesh.Trimesh, *tools: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.difference([solid, *tools], engine="manifold")
