"""The bodies of a mesh as one rigid solid: united where they overlap or touch, shells inside others filled.

manifold3d decides whether a surface is closed and computes the union, exactly and independently of the triangles.
"""

from __future__ import annotations

import manifold3d
import numpy as np
import trimesh
from manifold3d import Manifold
from numpy.typing import ArrayLike

from regrasp_opt.errors import MeshError

FLAT_VOLUME = 1e-6
"""A volume below this share of the cube of the longest extent counts as none."""


def to_manifold(mesh: trimesh.Trimesh) -> Manifold | None:
    """Return `mesh` for manifold3d; None unless each of its edges joins faces that are wound consistently."""
    found = _manifold(mesh.vertices, mesh.faces)
    return found if found.status() == manifold3d.Error.NoError else None


def to_trimesh(solid: Manifold) -> trimesh.Trimesh:
    """Return the surface of `solid`."""
    mesh = solid.to_mesh64()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts.astype(np.int64), process=False)


def one_solid(mesh: trimesh.Trimesh, where: str, *, repaired: bool = False) -> trimesh.Trimesh:
    """Return `mesh` if it is one body, else the union of its bodies with all cavities filled.

    If it was `repaired`, bodies that are inside out are turned, and no message suggests a repair.

    Raises
    ------
    MeshError
        If a body is open, wound inconsistently or inside out, or nothing encloses a volume; begins with `where`.
    """
    after, hint = (" even after the repair", "") if repaired else ("", " or try --repair")
    whole = to_manifold(mesh)
    if whole is None and not mesh.is_watertight:
        raise MeshError(f"{where} is not watertight{after}; close its surface{hint}")
    if whole is None and not mesh.is_winding_consistent:
        raise MeshError(f"{where} has faces of inconsistent winding{after}; orient them outward{hint}")
    bodies = [] if whole is None else whole.decompose()
    outward, solid = [body for body in bodies if body.volume() > 0], _filled(bodies)
    flat = FLAT_VOLUME * float(mesh.extents.max()) ** 3
    if solid.volume() < flat:
        raise MeshError(f"{where} encloses no volume{after}; give a solid, or pass --thickness for a thin sheet")
    if not repaired and solid.volume() > _union(outward).volume() + flat:
        raise MeshError(f"{where} is inside out (negative volume); orient its faces outward{hint}")
    if len(bodies) == len(outward) == 1 and mesh.is_watertight:
        return mesh
    return to_trimesh(_filled(solid.decompose()))


def _filled(shells: list[Manifold]) -> Manifold:
    """Return the union of what each of the closed `shells` has around it, whichever way it is wound."""
    return _union([shell if shell.volume() > 0 else _turned(shell) for shell in shells])


def _turned(shell: Manifold) -> Manifold:
    mesh = shell.to_mesh64()
    return _manifold(mesh.vert_properties, mesh.tri_verts[:, ::-1])


def _manifold(vertices: ArrayLike, faces: ArrayLike) -> Manifold:
    return Manifold(manifold3d.Mesh64(np.array(vertices, float, order="C"), np.array(faces, np.uint64, order="C")))


def _union(solids: list[Manifold]) -> Manifold:
    return Manifold.batch_boolean(solids, manifold3d.OpType.Add) if len(solids) > 1 else Manifold.compose(solids)
