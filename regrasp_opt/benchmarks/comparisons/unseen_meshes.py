"""Meshes that nothing was prepared for, built here: six families of nine, the same for the same seed [m].

What a jaw of 0.104 m can hold, mostly; some are too flat, too round or too wide for any plan, as real files are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from trimesh.creation import box, cone, icosphere, torus
from trimesh.transformations import rotation_matrix, translation_matrix

from regrasp_opt.conventions import FloatArray

Rng = np.random.Generator


def made_meshes(count: int, seed: int) -> dict[str, trimesh.Trimesh]:
    """Return the first `count` meshes by name, families in turn; at most ``VARIANTS`` of each.

    Every mesh has random numbers of its own, so it does not depend on `count`.
    """
    found: dict[str, trimesh.Trimesh] = {}
    for number in range(min(count, VARIANTS * len(FAMILIES))):
        variant, family = divmod(number, len(FAMILIES))
        name, build = list(FAMILIES.items())[family]
        if build is thin:
            name = f"{name}-{list(THIN)[variant]}"
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
            parts.append(box(rng.uniform(0.02, 0.07, 3), _at(*place)))
        else:
            parts.append(_peg(rng.uniform(0.008, 0.025), rng.uniform(0.04, 0.12), _at(*place)))
    turned = rotation_matrix(np.pi / 2 * rng.integers(2), [1, 0, 0])
    return _without(_union(*parts), _peg(rng.uniform(0.004, 0.012), 0.4).apply_transform(turned))


def plate() -> trimesh.Trimesh:
    """Return a plate of 200 x 150 x 6 mm."""
    return box([0.20, 0.15, 0.006])


def ring() -> trimesh.Trimesh:
    """Return a ring of 24 mm."""
    return torus(0.0105, 0.0015, major_sections=48, minor_sections=16)


def screwdriver() -> trimesh.Trimesh:
    """Return a screwdriver of 20 cm."""
    return _union(_peg(0.014, 0.1, _at(0, 0, -0.05)), _peg(0.003, 0.11, _at(0, 0, 0.045)))


def wrench() -> trimesh.Trimesh:
    """Return an open-ended wrench, 18 cm long and 6 mm thick."""
    heads = [_peg(r, 0.006, _at(x, 0, 0)) for r, x in ((0.018, -0.075), (0.015, 0.075))]
    solid = _union(box([0.15, 0.014, 0.006]), *heads)
    return _without(solid, box([0.03, 0.016, 0.02], _at(-0.09, 0, 0)), _peg(0.008, 0.02, _at(0.075, 0, 0)))


def scissors() -> trimesh.Trimesh:
    """Return open scissors, 16 cm long and 5 mm thick."""
    halves = []
    for side in (-1, 1):
        half = _without(_peg(0.016, 0.005, _at(-0.07, 0, 0)), _peg(0.011, 0.02, _at(-0.07, 0, 0)))
        half = _union(half, box([0.14, 0.009, 0.005], _at(0.015, 0, 0)))
        halves.append(half.apply_transform(rotation_matrix(side * 0.28, [0, 0, 1])))
    return _union(*halves)


def key() -> trimesh.Trimesh:
    """Return a key, 5.5 cm long and 2.5 mm thick."""
    head = _without(_peg(0.012, 0.0025), _peg(0.004, 0.02))
    return _union(head, box([0.042, 0.008, 0.0025], _at(0.03, 0, 0)))


def ruler() -> trimesh.Trimesh:
    """Return a ruler of 20 cm x 25 x 3 mm."""
    return box([0.20, 0.025, 0.003])


def spoon() -> trimesh.Trimesh:
    """Return a spoon of 18 cm, flat below."""
    bowl = icosphere(subdivisions=4).apply_transform(np.diag([0.03, 0.02, 0.01, 1.0]))
    hollow = icosphere(subdivisions=4).apply_transform(_at(0, 0, 0.003) @ np.diag([0.027, 0.017, 0.01, 1.0]))
    return _cut(_union(_without(bowl, hollow), box([0.13, 0.01, 0.004], _at(0.09, 0, 0))), -0.007)


def disc() -> trimesh.Trimesh:
    """Return a disc of 80 mm, 12 mm thick."""
    return _peg(0.04, 0.012)


THIN: dict[str, Callable[[], trimesh.Trimesh]] = {
    each.__name__: each for each in (plate, ring, screwdriver, wrench, scissors, key, ruler, spoon, disc)
}
VARIANTS = len(THIN)


def thin(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return one of the thin things that people pick up, in the order of `THIN`."""
    return list(THIN.values())[variant]()


def handled(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a can, a block or a cup with a ring handle at its side or on top."""
    radius, height = rng.uniform(0.025, 0.045), rng.uniform(0.05, 0.11)
    body = box([2 * radius, 2 * radius, height]) if variant % 3 == 1 else _peg(radius, height)
    handle = torus(rng.uniform(0.02, 0.03), rng.uniform(0.004, 0.007), major_sections=48, minor_sections=16)
    side = _at(radius - 0.002, 0, 0) if variant % 2 == 0 else _at(0, 0, height / 2)
    whole = _union(body, handle.apply_transform(side @ rotation_matrix(np.pi / 2, [1, 0, 0])))
    return _without(whole, _peg(radius - 0.004, height, _at(0, 0, 0.006))) if variant % 3 == 2 else whole


def shell(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a bowl, a cup, a tube, an open tray or a dome, with walls of 3 to 5 mm."""
    radius, height, wall = rng.uniform(0.03, 0.06), rng.uniform(0.05, 0.1), rng.uniform(0.003, 0.005)
    kind = variant % 5
    if kind == 0:
        ball = icosphere(subdivisions=5 if variant else 4)
        bowl = _without(ball.copy().apply_scale(radius), ball.copy().apply_scale(radius - wall))
        return _cut(_without(bowl, box([1, 1, 1], _at(0, 0, 0.5 + 0.3 * radius))), -0.97 * radius)
    if kind == 3:
        size = np.array([2 * radius, 1.4 * radius, 0.6 * height])
        return _without(box(size), box(size - [2 * wall, 2 * wall, 0], _at(0, 0, wall)))
    if kind == 4:
        ball = icosphere(subdivisions=4)
        return _cut(_without(ball.copy().apply_scale(radius), ball.copy().apply_scale(radius - wall)), 0.0)
    bottom = 2 * wall if kind == 1 else -height
    return _without(_peg(radius, height), _peg(radius - wall, 1.5 * height, _at(0, 0, height / 4 + bottom)))


def coarse(variant: int, rng: Rng) -> trimesh.Trimesh:
    """Return a convex body of few faces: the hull of some points, a wedge, or a pyramid's stump."""
    if variant % 3 == 1:
        x, y, z = rng.uniform(0.03, 0.09, 3)
        wedge = [(0, 0, 0), (x, 0, 0), (0, y, 0), (x, y, 0), (0, 0, z), (0, y, z)]
        return trimesh.convex.convex_hull(np.array(wedge))
    if variant % 3 == 2:
        return _without(
            cone(0.045, 0.12, sections=4 + variant), box([1, 1, 1], _at(0, 0, 0.5 + rng.uniform(0.05, 0.1)))
        )
    points = rng.normal(size=(8 + variant, 3))
    spread = rng.uniform(0.02, 0.05, 3)
    return trimesh.convex.convex_hull(points / np.linalg.norm(points, axis=1, keepdims=True) * spread)


FAMILIES: dict[str, Callable[[int, Rng], trimesh.Trimesh]] = {
    each.__name__: each for each in (superquadric, thin, constructed, shell, handled, coarse)
}


def _at(x: float, y: float, z: float) -> FloatArray:
    T: FloatArray = translation_matrix([x, y, z])
    return T


def _peg(radius: float, height: float, T: FloatArray | None = None) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, height, sections=64, transform=T)


def _cut(solid: trimesh.Trimesh, z: float) -> trimesh.Trimesh:
    """Return the part of `solid` above the height `z`."""
    return _without(solid, box([1, 1, 1], _at(0, 0, z - 0.5)))


def _union(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.union(list(parts), engine="manifold")


def _without(solid: trimesh.Trimesh, *tools: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.boolean.difference([solid, *tools], engine="manifold")
