"""Reading a mesh file into one rigid solid in metres, or saying in one sentence why that is not possible.

A closed mesh of one body is taken as it is; several bodies are united. Surfaces that are not closed are refused, unless
``repair`` or ``thickness`` is given; what these changed is logged. Frames and axes of the file are kept.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import trimesh

from regrasp_opt.errors import MeshError, OptionError
from regrasp_opt.geometry.mesh_files import quiet_trimesh, read_triangles
from regrasp_opt.objects.bodies import one_solid
from regrasp_opt.objects.changes import compare
from regrasp_opt.objects.repair import repaired, thickened

logger = logging.getLogger(__name__)

LARGEST, SMALLEST = 2.0, 0.005
"""Longest extents beyond which the file is taken to be in another unit [m]."""


def read_mesh(
    path: Path, *, scale: float = 1.0, repair: bool = False, thickness: float | None = None
) -> trimesh.Trimesh:
    """Return the solid in the file `path`, scaled to metres.

    Parameters
    ----------
    path : Path
        An STL, OBJ, PLY, GLB or DAE file.
    scale : float
        Metres per unit of the file.
    repair : bool
        Merge close vertices, drop degenerate and duplicate faces, fix the winding and close small holes; remesh
        what that does not close.
    thickness : float, optional
        Of the sheets in the file [m], half on either side; other surfaces stay as they are.

    Raises
    ------
    MeshError
        If the file cannot be read or holds no solid of a plausible size, also after a repair.
    OptionError
        If `scale` or `thickness` is not a positive number, or sheets would be thicker than a fifth of the object.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise OptionError(f"scale is {scale}; give a positive number of metres per unit of the file")
    vertices, faces = read_triangles(path)
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = vertices * scale
        extent = float(np.ptp(vertices[np.unique(faces)], axis=0).max())
    _check_size(path, extent, scale)
    if thickness is not None and not 0 < thickness <= extent / 5:
        raise OptionError(f"thickness is {thickness:g} m; give a positive number, here at most {extent / 5:.3g} m")
    file = mesh = trimesh.Trimesh(vertices, faces, process=True)
    with quiet_trimesh():
        if repair:
            mesh = repaired(mesh, str(path), sheets=thickness is not None)
        if thickness is not None:
            mesh = thickened(mesh, thickness, str(path))
        mesh = one_solid(mesh, str(path), repaired=repair)
        if repair or thickness is not None:
            changes = compare(file, mesh)
            if changes is not None:
                logger.warning("%s was changed: %s", path, changes.sentence())
    return mesh


def _check_size(path: Path, extent: float, scale: float) -> None:
    if not extent <= LARGEST:
        raise MeshError(f"{path} is {extent:.4g} m long and looks like millimetres; pass --scale {scale * 0.001:g}")
    if extent < SMALLEST:
        raise MeshError(
            f"{path} is only {extent:.3g} m long and was perhaps scaled twice; pass --scale {scale * 1000:g}"
        )
