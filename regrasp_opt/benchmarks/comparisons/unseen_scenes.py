"""Obstacles that nothing was prepared for: boxes, cylinders and meshes that stand on the table, from one seed."""

from __future__ import annotations

import numpy as np

from regrasp_opt.benchmarks.comparisons.unseen_meshes import VARIANTS, constructed
from regrasp_opt.conventions import FloatArray, planar_transform, translation
from regrasp_opt.errors import WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.planning import RegraspProblem

FEWEST, MOST = 3, 12
"""Obstacles of a scene."""


def random_scene(problem: RegraspProblem, rng: np.random.Generator) -> list[Shape]:
    """Return `FEWEST` to `MOST` obstacles around the workspace of `problem`, none of which the robot at home is in."""
    low, high = problem.workcell.bounds.array
    wanted, found = int(rng.integers(FEWEST, MOST + 1)), list[Shape]()
    while len(found) < wanted:
        spot = np.append(rng.uniform(low - 0.05, high + 0.05), rng.uniform(0, 2 * np.pi))
        T = translation(0, 0, problem.workcell.table.height) @ planar_transform(spot)
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
        return Box(name, np.array([*rng.uniform(0.04, 0.18, 2), height]), T @ translation(0, 0, height / 2))
    if kind == 1:
        return Cylinder(name, float(rng.uniform(0.015, 0.06)), height, T @ translation(0, 0, height / 2))
    mesh = constructed(int(rng.integers(VARIANTS)), rng)
    return Mesh(name, mesh.vertices, mesh.faces, T @ translation(0, 0, -float(mesh.bounds[0, 2])))
