"""Triangles of a COLLADA file (DAE), in metres.

Lengths are multiplied with the file's unit. Its ``up_axis`` is ignored, as in RViz, MoveIt and Gazebo, for which
URDF files are made: the axes of the file are those of the link.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import MeshError

_SURFACES = {"triangles", "polylist", "polygons", "tristrips", "trifans"}
_FLAT = {"source", "vertices", "lines", "linestrips", "extra"}
"""Children of a mesh without area."""


def read_collada(path: Path) -> tuple[FloatArray, IntArray]:
    """Return vertices (V, 3) [m] and triangles (F, 3) of the scene in a file; a broken file may raise anything.

    Raises
    ------
    MeshError
        If the scene holds something without a fixed surface: splines, controllers, polygons with holes.
    """
    root = ET.fromstring(path.read_bytes())
    for element in root.iter():
        element.tag = str(element.tag).rpartition("}")[2]
    known = {f"#{element.get('id')}": element for element in root.iter() if "id" in element.attrib}
    unit = root.find("asset/unit")
    meter = 1.0 if unit is None else float(unit.get("meter", "1"))
    scene = root.find("scene/instance_visual_scene")
    nodes = [known[scene.get("url", "")]] if scene is not None else list(root.iter("visual_scene"))
    parts = [part for node in nodes for part in _node(node, np.diag([meter, meter, meter, 1.0]), known, path)]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [faces + start for (_, faces), start in zip(parts, starts, strict=False)]
    return np.concatenate([np.zeros((0, 3)), *(v for v, _ in parts)]), np.concatenate([np.zeros((0, 3), int), *faces])


def _node(
    node: ET.Element, T: FloatArray, known: dict[str, ET.Element], path: Path
) -> Iterator[tuple[FloatArray, IntArray]]:
    """Yield vertices and triangles of what hangs on a node, whose parent is at `T` (4, 4)."""
    for child in node:
        if child.tag in ("matrix", "translate", "rotate", "scale"):
            T = T @ _transform(child.tag, _numbers(child))
        elif child.tag in ("lookat", "skew", "instance_controller"):
            raise MeshError(f"{path} has a <{child.tag}>, which is not supported; export the mesh as STL")
        elif child.tag in ("node", "instance_node"):
            yield from _node(child if child.tag == "node" else known[child.get("url", "")], T, known, path)
        elif child.tag == "instance_geometry":
            for mesh in known[child.get("url", "")]:
                if mesh.tag in ("spline", "convex_mesh", "brep"):
                    raise MeshError(f"{path} has a <{mesh.tag}>, which is not supported; export the mesh as STL")
                for vertices, faces in _mesh(mesh, known, path) if mesh.tag == "mesh" else ():
                    yield vertices @ T[:3, :3].T + T[:3, 3], faces


def _transform(kind: str, numbers: FloatArray) -> FloatArray:
    T = np.eye(4)
    if kind == "matrix":
        return numbers.reshape(4, 4)
    if kind == "translate":
        T[:3, 3] = numbers
    elif kind == "scale":
        T[:3, :3] = np.diag(numbers)
    else:
        T[:3, :3] = Rotation.from_rotvec(numbers[:3] / np.linalg.norm(numbers[:3]) * np.deg2rad(numbers[3])).as_matrix()
    return T


def _mesh(mesh: ET.Element, known: dict[str, ET.Element], path: Path) -> Iterator[tuple[FloatArray, IntArray]]:
    """Yield vertices and triangles of each group of faces; polygons become fans."""
    for group in mesh:
        if group.tag in _FLAT:
            continue
        if group.tag not in _SURFACES or group.find("ph") is not None:
            raise MeshError(f"{path} has <{group.tag}>, which is not supported; export the mesh as STL")
        inputs = group.findall("input")
        stride = 1 + max(int(one.get("offset", "0")) for one in inputs)
        vertex = next(one for one in inputs if one.get("semantic") == "VERTEX")
        runs = [np.array((p.text or "").split(), dtype=np.int64).reshape(-1, stride) for p in group.iterfind("p")]
        if not runs:
            continue
        corners = np.concatenate(runs)[:, int(vertex.get("offset", "0"))]
        if group.tag == "triangles":
            counts = np.full(len(corners) // 3, 3)
        elif group.tag == "polylist":
            counts = np.array((group.findtext("vcount") or "").split(), dtype=np.int64)
        else:
            counts = np.array([len(run) for run in runs])
        if counts.sum() != len(corners):
            raise ValueError("corners are missing")
        yield _positions(known[vertex.get("source", "")], known), corners[_triangles(counts, group.tag == "tristrips")]


def _triangles(counts: IntArray, strips: bool) -> IntArray:
    """Return triangles (F, 3) of the corners of polygons, which follow each other, `counts` (P,) of them for each."""
    within = np.maximum(counts - 2, 0)
    step = np.arange(within.sum()) - np.repeat(np.cumsum(within) - within, within)
    first = np.repeat(np.cumsum(counts) - counts, within)
    if strips:
        odd = step % 2
        return np.stack([first + step, first + step + 1 + odd, first + step + 2 - odd], axis=1)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def _positions(vertices: ET.Element, known: dict[str, ET.Element]) -> FloatArray:
    """Return the points (V, 3) that a <vertices> element names."""
    place = next(one for one in vertices.iterfind("input") if one.get("semantic") == "POSITION")
    source = known[place.get("source", "")]
    accessor = source.find("technique_common/accessor")
    stride, offset = (
        (3, 0) if accessor is None else (int(accessor.get(k, d)) for k, d in (("stride", 3), ("offset", 0)))
    )
    array = source.find("float_array")
    numbers = np.array(((array.text if array is not None else None) or "").split(), dtype=np.float64)[offset:]
    return numbers[: len(numbers) // stride * stride].reshape(-1, stride)[:, :3]


def _numbers(element: ET.Element) -> FloatArray:
    return np.array((element.text or "").split(), dtype=np.float64)
