"""Triangles from mesh files, for objects, obstacles and robot links alike: complete and sound, or refused.

The libraries that use the triangles trust them: an index beyond the vertices makes the collision library read memory
that is not its own.
"""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.stl import HeaderError

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import MeshError
from regrasp_opt.geometry.collada import read_collada

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".glb", ".dae")
"""The file formats that are read."""

FARTHEST = 1e9
"""How far from the origin vertices may be, in the unit of the file; beyond, single precision overflows."""

LARGEST_MESH = 20.0
"""A mesh of a body that stands still is taken to be in another unit if it is longer than this [m]."""

SMALLEST_BODY = 0.001
"""A body whose mesh is smaller than this was scaled twice [m]."""

_UNITS = ((0.001, "millimetres"), (1e-6, "micrometres"))

UNREADABLE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, AssertionError, RuntimeError, NameError, EOFError,
    ImportError, SyntaxError, MemoryError, ArithmeticError, struct.error, HeaderError,
)  # fmt: skip
"""What the readers of the several formats raise on a broken file."""


def read_triangles(path: Path) -> tuple[FloatArray, IntArray]:
    """Return the vertices (V, 3) and the triangles (F, 3) of an STL, OBJ, PLY, GLB or DAE file.

    Vertices are in the file's unit; in metres where the format states it (DAE).

    Raises
    ------
    MeshError
        If the file is missing, of another format or broken, has no triangles, vertices that are not finite or too far
        away, or triangles of vertices that it does not hold.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise MeshError(f"{path} is not a mesh file that can be read; give one of {', '.join(MESH_SUFFIXES)}")
    if not os.path.isfile(path):
        raise MeshError(f"mesh file {path} does not exist; give the path of an STL, OBJ, PLY, GLB or DAE file")
    try:
        with quiet_trimesh():
            if path.suffix.lower() == ".dae":
                vertices, faces = read_collada(path)
            else:
                loaded = trimesh.load_mesh(path, process=False)
                vertices = np.array(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=np.float64)
                faces = np.array(getattr(loaded, "faces", np.zeros((0, 3))), dtype=np.int64)
    except UNREADABLE as error:
        raise MeshError(f"{path} is corrupt, truncated or not a mesh file; export it again") from error
    if len(faces) == 0:
        raise MeshError(f"{path} contains no triangles; give a surface mesh")
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or not 0 <= faces.min() <= faces.max() < len(vertices):
        raise MeshError(f"{path} has triangles whose vertices do not exist; export it again")
    if not np.isfinite(vertices).all():
        raise MeshError(f"{path} has vertices that are NaN or infinite; export the mesh again")
    if np.abs(vertices).max() > FARTHEST:
        raise MeshError(f"{path} has vertices more than {FARTHEST:g} units from the origin; export the mesh again")
    return vertices, faces


def unlikely_size(points: FloatArray, largest: float) -> tuple[str, float] | None:
    """Return a clause about the size of a body's mesh [m] and a factor that would make sense; None if it does already.

    Parameters
    ----------
    points : (V, 3) array
        Vertices that faces use [m].
    largest : float
        Longest extent that is believed [m]; five times as much for the distance from the mesh's origin.
    """
    extent, far = float(np.ptp(points, axis=0).max()), float(np.abs(points).max())
    if extent < SMALLEST_BODY:
        return f"is only {extent:.3g} m long and was perhaps scaled twice", 1000.0
    if extent <= largest and far <= 5 * largest:
        return None
    size = max(extent, far / 5)
    factor, unit = next(((f, unit) for f, unit in _UNITS if size * f <= largest), _UNITS[-1])
    what = f"is {extent:.4g} m long" if extent > largest else f"reaches {far:.4g} m from its origin"
    return f"{what} and looks like {unit}", factor


@contextmanager
def quiet_trimesh() -> Iterator[None]:
    """Keep off the screen what trimesh logs, and NumPy warns of, about a broken mesh; it raises exceptions as well."""
    logger, silent = logging.getLogger("trimesh"), logging.NullHandler()
    before, logger.propagate = logger.propagate, False
    logger.addHandler(silent)
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        logger.removeHandler(silent)
        logger.propagate = before
