"""Triangles from mesh files, for objects, obstacles and robot links alike: read whole and sound, or refused.

The libraries that use the triangles believe them: an index beyond the vertices makes the collision library read memory
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

from regrasp_opt.collada import read_collada
from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import MeshError

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".glb", ".dae")
"""The file formats that are read."""

FARTHEST = 1e9
"""How far from the origin vertices may be, in the unit of the file; beyond, single precision overflows."""

UNREADABLE = (
    OSError, ValueError, LookupError, TypeError, AttributeError, AssertionError, RuntimeError, NameError, EOFError,
    ImportError, SyntaxError, MemoryError, ArithmeticError, struct.error, HeaderError,
)  # fmt: skip
"""What the readers of the several formats raise on a broken file."""


def read_triangles(path: Path) -> tuple[FloatArray, IntArray]:
    """Return the vertices (V, 3) in the file's unit and the triangles (F, 3) of an STL, OBJ, PLY or GLB file.

    Raises
    ------
    MeshError
        If the file is missing, of another format or broken, has no triangles, vertices that are not finite or too far
        away, or triangles of vertices that it does not hold.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise MeshError(f"{path} is no mesh file that can be read; give one of {', '.join(MESH_SUFFIXES)}")
    if not os.path.isfile(path):
        raise MeshError(f"mesh file {path} does not exist; give the path of an STL, OBJ, PLY or GLB file")
    try:
        with quiet_trimesh():
            if path.suffix.lower() == ".dae":
                vertices, faces = read_collada(path)
            else:
                loaded = trimesh.load_mesh(path, process=False)
                vertices = np.array(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=np.float64)
                faces = np.array(getattr(loaded, "faces", np.zeros((0, 3))), dtype=np.int64)
    except UNREADABLE as error:
        raise MeshError(f"{path} is corrupt, truncated or no mesh file; export it again") from error
    if len(faces) == 0:
        raise MeshError(f"{path} holds no triangles; give a surface mesh")
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or not 0 <= faces.min() <= faces.max() < len(vertices):
        raise MeshError(f"{path} has triangles of vertices that it does not hold; export it again")
    if not np.isfinite(vertices).all():
        raise MeshError(f"{path} has vertices that are NaN or infinite; export the mesh again")
    if np.abs(vertices).max() > FARTHEST:
        raise MeshError(f"{path} has vertices more than {FARTHEST:g} units away; export the mesh again")
    return vertices, faces


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
