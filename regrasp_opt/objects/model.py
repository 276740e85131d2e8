"""The object that is regrasped: one solid mesh with the ways in which it rests on a table."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import OptionError, UnknownNameError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.mesh_files import MESH_SUFFIXES
from regrasp_opt.geometry.shapes import mesh_geometry
from regrasp_opt.geometry.solids import Solid
from regrasp_opt.objects.builtin import OBJECT_NAMES, build
from regrasp_opt.objects.mass import NOTHING_GIVEN, SAME, MassProperties, mass_properties
from regrasp_opt.objects.mesh import LARGEST, SMALLEST, read_mesh
from regrasp_opt.objects.placements import Placement, stable_placements
from regrasp_opt.objects.rolling import Hull


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid solid, of one body or several that keep their places; of uniform density unless told otherwise.

    Attributes
    ----------
    name : str
        The built-in name, or the stem of the file's name.
    mesh : trimesh.Trimesh
        Watertight surfaces with outward normals in the object frame, which is that of the file [m].
    placements : tuple of Placement
        Stable placements by decreasing margin; empty if there are none.
    source : str
        ``"built-in"`` or the path of the file.
    scale, repair, thickness
        What `load_object` was told, so that the same object can be loaded again.
    given : MassProperties
        What was given of the mass properties, as arguments or in the file beside the mesh.
    """

    name: str
    mesh: trimesh.Trimesh
    placements: tuple[Placement, ...]
    source: str = "built-in"
    scale: float = 1.0
    repair: bool = False
    thickness: float | None = None
    given: MassProperties = NOTHING_GIVEN

    @cached_property
    def vertices(self) -> FloatArray:
        """Vertices (V, 3) in the object frame [m], read-only."""
        vertices = np.array(self.mesh.vertices, dtype=np.float64)
        vertices.flags.writeable = False
        return vertices

    @cached_property
    def faces(self) -> IntArray:
        """Triangles (F, 3) as vertex indices, counter-clockwise from outside, read-only."""
        faces = np.array(self.mesh.faces, dtype=np.int64)
        faces.flags.writeable = False
        return faces

    @cached_property
    def center_of_mass(self) -> FloatArray:
        """Centre of mass (3,) in the object frame [m]."""
        return _center_of_mass(self.mesh, self.given)

    @property
    def mass(self) -> float | None:
        """Mass [kg]; None where neither it nor a density was given."""
        return self.given.mass or (self.given.density and self.given.density * float(self.mesh.volume))

    @property
    def inertia(self) -> FloatArray | None:
        """Inertia (3, 3) about the centre of mass, along the axes of the object frame [kg m^2]; None without a mass.

        Where none was given it is that of uniform density about its own centre.
        """
        if self.given.inertia is not None:
            return np.array(self.given.inertia, dtype=np.float64)
        return None if self.mass is None else np.array(self.mesh.moment_inertia * (self.mass / self.mesh.mass))

    @cached_property
    def solid(self) -> Solid:
        """The mesh as Coal tests it, with its inside."""
        return Solid(mesh_geometry(self.vertices, self.faces), self.faces)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the fields alone: Coal's part of the rest cannot travel."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def corners(self) -> FloatArray:
        """Vertices (H, 3) of the convex hull in the object frame [m]: the lowest one is the lowest of all."""
        return self.vertices[np.unique(self._hull.simplices)]

    @cached_property
    def _hull(self) -> Hull:
        return Hull(self.vertices - self.center_of_mass)

    def rolls(self, T: FloatArray) -> bool:
        """Return whether the object can roll where it rests at the pose `T` (4, 4) on a level table."""
        if any(T[2, :3] @ placement.pose[2, :3] > 1.0 - 1e-9 for placement in self.placements):
            return False
        return self._hull.rolls(self._hull.facet_below(-T[2, :3]))

    @cached_property
    def _fingerprint(self) -> str:
        uniform = np.array_equal(self.center_of_mass, self.mesh.center_mass)
        return content_hash("object", self.vertices, self.faces, *(() if uniform else (self.center_of_mass,)))

    def fingerprint(self) -> str:
        """Return a hash of what decides feasibility: vertices, faces, and a centre of mass that is not the uniform one.

        Name and source are not part of it, nor are mass and inertia.
        """
        return self._fingerprint


def load_object(
    name_or_path: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    repair: bool = False,
    thickness: float | None = None,
    mass: float | None = None,
    density: float | None = None,
    center_of_mass: ArrayLike | None = None,
    inertia: ArrayLike | None = None,
) -> ObjectModel:
    """Return a built-in object by name, or any other from the path of its mesh file.

    A string is taken as a path when it ends in a mesh suffix, has a folder in it or names a file. Bodies that overlap
    or touch are united, cavities filled; bodies that are apart are one rigid object.

    Parameters
    ----------
    name_or_path : str or path
        ``"bottle"``, ``"mug"``, ``"pentagon"``, ``"figurine"``, or an STL, OBJ, PLY, GLB or DAE file.
    scale : float
        Metres per unit of the file, for example 0.001; also scales a built-in object.
    repair : bool
        Repair the file's mesh where that can be done safely; a warning says what was changed.
    thickness : float, optional
        Thickness that sheets, surfaces that enclose nothing, are given [m].
    mass, density : float, optional
        Mass [kg], or mass over the volume of the mesh [kg/m^3].
    center_of_mass : (3,), optional
        In the object frame [m]; that of uniform density by default. Placements and margins follow it.
    inertia : (3, 3), optional
        About the centre of mass, along the axes of the object frame [kg m^2]; needs a mass or density. All four may be
        in a TOML file beside the mesh instead (`regrasp_opt.objects.mass`).

    Raises
    ------
    UnknownNameError
        If the string is neither a built-in name nor a path.
    MeshError
        If the file cannot be read or holds no solid of a plausible size; names the repair where there is one.
    OptionError
        If `scale` or `thickness` is not a positive number, or makes no sense for the object; if mass properties are
        not those of a rigid body there, or the file beside the mesh is wrong or says something else.
    """
    given = {"mass": mass, "density": density, "center_of_mass": center_of_mass, "inertia": inertia}
    path: Path | None
    if isinstance(name_or_path, str) and name_or_path in OBJECT_NAMES:
        if thickness is not None:
            raise OptionError(f"the built-in {name_or_path} has no open sheet; omit the thickness")
        name, path, mesh = name_or_path, None, _built_in(name_or_path, scale)
    else:
        name, path = Path(name_or_path).stem, Path(name_or_path)
        is_bare = isinstance(name_or_path, str) and path.name == name_or_path and not os.path.isfile(path)
        if is_bare and path.suffix.lower() not in MESH_SUFFIXES:
            raise UnknownNameError("object", str(name_or_path), OBJECT_NAMES)
        mesh = read_mesh(path, scale=scale, repair=repair, thickness=thickness)
    known = mass_properties(given, mesh, path, name)
    placements = stable_placements(mesh, center_of_mass=_center_of_mass(mesh, known))
    source = "built-in" if path is None else str(path)
    return ObjectModel(name, mesh, placements, source, scale, repair, thickness, known)


def _center_of_mass(mesh: trimesh.Trimesh, given: MassProperties) -> FloatArray:
    """Return the centre of mass that was given (3,), or that of uniform density where the two are the same."""
    uniform = np.array(mesh.center_mass, dtype=np.float64)
    center = uniform if given.center_of_mass is None else np.array(given.center_of_mass)
    return uniform if np.abs(center - uniform).max() <= SAME else center


def _built_in(name: str, scale: float) -> trimesh.Trimesh:
    if not (np.isfinite(scale) and scale > 0):
        raise OptionError(f"scale is {scale}; give a positive number")
    mesh = build(name)
    extent = float(mesh.extents.max()) * scale
    if not SMALLEST <= extent <= LARGEST:
        raise OptionError(
            f"scale is {scale} and makes the {name} {extent:.3g} m long; give one that makes it {SMALLEST:g} to "
            f"{LARGEST:g} m long"
        )
    return mesh if scale == 1.0 else trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)
