"""Mending a mesh that is not closed, as far as that is safe, and giving sheets a thickness.

What can be mended exactly keeps its surface: vertices that nearly coincide are merged, small holes closed. Anything
else that still encloses a volume is remeshed: of what a ball cannot reach from outside (a morphological closing) the
surface is extracted on a grid, and its vertices are moved to the nearest points of the given surface.
"""

from __future__ import annotations

from itertools import islice

import numpy as np
import trimesh
from manifold3d import Manifold
from scipy.ndimage import label, map_coordinates
from scipy.spatial import KDTree

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import MeshError
from regrasp_opt.geometry.shapes import mesh_geometry
from regrasp_opt.geometry.solids import Solid, merge_close
from regrasp_opt.objects.bodies import to_manifold, to_trimesh
from regrasp_opt.objects.changes import nearest_points

MERGE_DISTANCE = 1e-5
"""Vertices closer than this share of the longest extent are one after a repair."""

LARGEST_PATCH = 0.005
"""Largest share of the surface that a repair may invent to close holes."""

FLUSH = np.deg2rad(45.0)
"""A single triangle that is missing is put back, however large, if it continues a neighbour within this angle [rad]."""

CELLS = 80
"""Cells of the remeshing grid along the longest extent; a ball of one cell's radius is outside."""

SHARP = 0.03
"""Ratio of (1 - cos) to (1 + cos) of a bend, below which the thickness of a sheet is kept only on average there."""

LARGEST_AREA = 50.0
"""Largest area of what is remeshed, as a multiple of the square of its longest extent; a box has at most 6."""

THIN_SHARE = 0.01
"""Largest share of the surface that may enclose nothing after a repair."""

_SAMPLES = 300
"""Points of the surface that are tested for this."""


def repaired(mesh: trimesh.Trimesh, where: str, *, sheets: bool = False) -> trimesh.Trimesh:
    """Return `mesh` with closed surfaces, if possible; those of `sheets` may stay open.

    Raises
    ------
    MeshError
        If nothing is left of it, or a hole is too large to close; `where` comes first.
    """
    first, merged = merge_close(mesh.vertices, MERGE_DISTANCE * mesh.extents.max())
    mesh = trimesh.Trimesh(mesh.vertices[first], merged[mesh.faces], process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    if len(mesh.faces) < 4 and not sheets:
        raise MeshError(f"{where} has too few faces left after the repair; give a solid")
    if to_manifold(mesh) is not None:
        return mesh
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    trimesh.repair.fix_winding(mesh)
    mesh = _without_holes(mesh)
    if sheets or to_manifold(mesh) is not None:
        return mesh
    if mesh.area > LARGEST_AREA * mesh.extents.max() ** 2:
        raise MeshError(f"{where} has too much surface inside it to be repaired; leave out what cannot be seen")
    solid = remeshed(mesh)
    if _has_sheets(mesh, solid):
        raise MeshError(
            f"{where} has sheets, or openings too large to close safely: part of its surface encloses nothing; "
            "close them first, or give sheets a thickness with --thickness"
        )
    return solid


def _has_sheets(mesh: trimesh.Trimesh, solid: trimesh.Trimesh) -> bool:
    """Return whether more than `THIN_SHARE` of the surface of `mesh` has none of `solid` on either side."""
    points, face = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)
    steps = mesh.face_normals[face] * solid.extents.max() / CELLS / 10
    inside = Solid(mesh_geometry(solid.vertices, solid.faces))
    thin = (1 for p, s in zip(points, steps, strict=True) if not inside.holds(np.array([p + s, p - s])))
    return len(list(islice(thin, int(THIN_SHARE * _SAMPLES) + 1))) > THIN_SHARE * _SAMPLES


def _without_holes(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return `mesh` with its holes closed; as it was, if that takes much surface."""
    filled, count = mesh.copy(), len(mesh.faces)
    trimesh.repair.fill_holes(filled, use_fan=True)
    pairs, bends = filled.face_adjacency, filled.face_adjacency_angles
    beside = (pairs[:, 0] < count) & (pairs[:, 1] >= count)
    given, flush = (
        np.bincount(pairs[which, 1], minlength=len(filled.faces))[count:]
        for which in (beside, beside & (bends < FLUSH))
    )
    put_back = (given == 3) & (flush > 0)
    return filled if filled.area_faces[count:][~put_back].sum() < LARGEST_PATCH * mesh.area else mesh


def thickened(mesh: trimesh.Trimesh, thickness: float, where: str) -> trimesh.Trimesh:
    """Return `mesh` with half of `thickness` [m] added on either side of each of its sheets, and edges between.

    Sheets keep the thickness where they bend: a vertex moves by the vector, of least squares, whose component along the
    normal of each face around it is half the thickness.

    Raises
    ------
    MeshError
        If nothing of it is open; `where` comes first.
    """
    mesh, whole = mesh.copy(), to_manifold(mesh)
    mesh.update_faces(mesh.unique_faces())  # some sheets have a face for each side
    trimesh.repair.fix_winding(mesh)
    parts = mesh.split(only_watertight=False, repair=False)
    if (whole is not None and abs(whole.volume()) > 0) or all(part.is_watertight for part in parts):
        raise MeshError(f"{where} has no open sheet that could be given a thickness; omit --thickness")
    return trimesh.util.concatenate([p if p.is_watertight else _extruded(p, thickness) for p in parts])


def _extruded(sheet: trimesh.Trimesh, thickness: float) -> trimesh.Trimesh:
    count, faces, normals = len(sheet.vertices), sheet.faces, np.repeat(sheet.face_normals, 3, axis=0)
    squares, sums = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(squares, faces.ravel(), normals[:, :, None] * normals[:, None, :])
    np.add.at(sums, faces.ravel(), normals)
    move = np.einsum("vij,vj->vi", np.linalg.pinv(squares, rcond=SHARP, hermitian=True), sums)
    move *= thickness / 2 / np.maximum(np.linalg.norm(move, axis=1, keepdims=True) / 2, 1.0)
    a, b = sheet.edges[trimesh.grouping.group_rows(sheet.edges_sorted, require_count=1)].T
    sides = np.stack([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])
    vertices = np.concatenate([sheet.vertices + move, sheet.vertices - move])
    return trimesh.Trimesh(
        vertices, np.concatenate([faces, faces[:, ::-1] + count, sides.reshape(-1, 3)]), process=False
    )


def remeshed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a closed surface around `mesh`, whose vertices are on it; gaps narrower than two cells are closed."""
    step = float(mesh.extents.max()) / CELLS
    low, high = mesh.bounds[0] - 4 * step, mesh.bounds[1] + 4 * step
    size = np.ceil((high - low) / step).astype(int) + 1
    grid = low + step * np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1)
    far = 2 * step
    distance = np.minimum(KDTree(_spread(mesh.triangles, step)).query(grid, distance_upper_bound=far)[0], far)
    spaces, _ = label(distance > step)
    depth = np.where((distance > step) & (spaces != spaces[0, 0, 0]), step, step - distance)
    points: list[tuple[float, float, float]] = []

    def note(x: float, y: float, z: float) -> float:
        points.append((x, y, z))
        return -1.0

    box = (*low, *(low + step * (size - 1)))
    Manifold.level_set(note, box, step)
    values = map_coordinates(depth, (np.array(points) - low).T / step, order=1, mode="nearest")
    known = dict(zip(points, values.tolist(), strict=True))
    around = Manifold.level_set(lambda *point: known[point], box, step)
    return to_trimesh(around.warp_batch(lambda at: nearest_points(mesh, at)[1]).simplify(step / 20))


def _spread(triangles: FloatArray, spacing: float) -> FloatArray:
    """Return points (N, 3) on `triangles` (F, 3, 3) in rows along their longest sides, at most `spacing` apart."""
    sides = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    order = (sides.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(triangles, order[:, :, None], axis=1), 1, 0)
    longest = sides.max(axis=1)
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-12)
    columns, rows = (np.ceil(length / spacing).astype(int).clip(min=1) for length in (longest, height))
    counts = (columns + 1) * (rows + 1)
    face = np.repeat(np.arange(len(triangles)), counts)
    number = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    along, up = (number // (rows + 1)[face] / columns[face])[:, None], (number % (rows + 1)[face] / rows[face])[:, None]
    points: FloatArray = (1 - up) * ((1 - along) * a[face] + along * b[face]) + up * c[face]
    return points
