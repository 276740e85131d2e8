"""Reading a mesh file into one watertight solid in metres, or saying in one sentence why that is not possible.

A mesh is taken as it is or refused; only with ``repair`` is it changed, and then the result is held to the
same checks. Frames and axes of the file are kept.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from regrasp_opt.errors import MeshError, OptionError
from regrasp_opt.geometry.mesh_files import quiet_trimesh, read_triangles
from regrasp_opt.geometry.solids import merge_close

LARGEST, SMALLEST = 2.0, 0.005
"""Longest extents beyond which the file is taken to be in another unit [m]."""

FLAT_VOLUME = 1e-6
"""A volume below this share of the cube of the longest extent counts as none."""

MERGE_DISTANCE = 1e-5
"""Vertices closer than this share of the longest extent are one after a repair."""

LARGEST_PATCH = 0.25
"""Largest share of the surface that a repair may invent to close holes."""


def read_mesh(path: Path, *, scale: float = 1.0, repair: bool = False) -> trimesh.Trimesh:
    """Return the solid in the file `path`, scaled to metres.

    Parameters
    ----------
    path : Path
        An STL, OBJ, PLY, GLB or DAE file.
    scale : float
        Metres per unit of the file.
    repair : bool
        Merge close vertices, drop degenerate and duplicate faces, fix the winding, close small holes and
        unite overlapping bodies.

    Raises
    ------
    MeshError
        If the file cannot be read or holds no solid of a plausible size, also after a repair.
    OptionError
        If `scale` is not a positive number.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise OptionError(f"scale is {scale}; give a positive number of metres per unit of the file")
    vertices, faces = read_triangles(path)
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = vertices * scale
        extent = float(np.ptp(vertices[np.unique(faces)], axis=0).max())
    _check_size(path, extent, scale)
    mesh = trimesh.Trimesh(vertices, faces, process=True)
    with quiet_trimesh():  # NumPy warns of the centre of mass of a flat mesh
        if repair:
            mesh = _repaired(path, mesh)
        check_solid(mesh, str(path), repaired=repair)
    return mesh


def check_solid(mesh: trimesh.Trimesh, where: str, *, repaired: bool = False) -> None:
    """Raise MeshError, with `where` in front, unless `mesh` is one watertight solid with outward normals."""
    after, hint = (" even after the repair", "") if repaired else ("", " or try --repair")
    if not mesh.is_watertight:
        raise MeshError(f"{where} is not watertight{after}; close its surface{hint}")
    if not mesh.is_winding_consistent:
        raise MeshError(f"{where} has faces of inconsistent winding{after}; orient them outward{hint}")
    if abs(mesh.volume) < FLAT_VOLUME * mesh.extents.max() ** 3:
        raise MeshError(f"{where} encloses no volume{after}; give a solid rather than a flat surface")
    if mesh.volume < 0:
        raise MeshError(f"{where} is inside out (negative volume){after}; orient its faces outward{hint}")
    if mesh.body_count > 1:
        raise MeshError(
            f"{where} consists of {mesh.body_count} bodies that are not joined{after}; "
            f"give one solid without inner cavities{hint and ' or unite overlapping bodies with --repair'}"
        )


def _check_size(path: Path, extent: float, scale: float) -> None:
    if not extent <= LARGEST:
        raise MeshError(f"{path} is {extent:.4g} m long and looks like millimetres; pass --scale {scale * 0.001:g}")
    if extent < SMALLEST:
        raise MeshError(
            f"{path} is only {extent:.3g} m long and was perhaps scaled twice; pass --scale {scale * 1000:g}"
        )


def _repaired(path: Path, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a cleaned mesh: as clean as trimesh and manifold3d make it without inventing much surface."""
    first, label = merge_close(mesh.vertices, MERGE_DISTANCE * mesh.extents.max())
    mesh = trimesh.Trimesh(mesh.vertices[first], label[mesh.faces], process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) < 4:
        raise MeshError(f"{path} has too few faces left after the repair; give a solid")
    trimesh.repair.fix_winding(mesh)
    area = mesh.area
    trimesh.repair.fill_holes(mesh, use_fan=True)
    if mesh.area > area / (1.0 - LARGEST_PATCH):
        raise MeshError(
            f"{path} has holes too large to close safely ({1 - area / mesh.area:.0%} of its area); close them first"
        )
    bodies = mesh.split(only_watertight=False, repair=False)
    if len(bodies) > 1:
        return _united(path, bodies)
    trimesh.repair.fix_normals(mesh)
    return mesh


def _united(path: Path, bodies: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return the union of watertight bodies; one inside another is a cavity or a mistake, and is refused."""
    for body in bodies:
        trimesh.repair.fix_normals(body)
        if not body.is_volume:
            raise MeshError(f"{path} has a body that is not watertight even after the repair; close its surface")
        inside = [other for other in bodies if other is not body and _encloses(other, body)]
        if inside:
            raise MeshError(f"{path} has a body or cavity inside another; remove the inner one, or cut it open")
    return trimesh.boolean.union(bodies, engine="manifold")


def _encloses(outer: trimesh.Trimesh, inner: trimesh.Trimesh) -> bool:
    if not ((outer.bounds[0] < inner.bounds[0]).all() and (inner.bounds[1] < outer.bounds[1]).all()):
        return False
    common = trimesh.boolean.intersection([outer, inner], engine="manifold")
    return bool(common.volume > (1.0 - 1e-6) * inner.volume)
