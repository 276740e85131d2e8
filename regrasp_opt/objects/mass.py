"""Mass properties of an object: what is given of them, and what is of uniform density.

Each of mass, density, centre of mass and inertia may be given as an argument, or in a TOML file beside the mesh
(``bottle.toml`` beside ``bottle.stl``)::

    schema = 1
    mass = 0.4                          # [kg]; or density = 950 [kg/m^3], the mass over the volume of the mesh
    center_of_mass = [0.0, 0.0, 0.07]   # [m], in the frame of the mesh
    inertia = [[2e-3, 0, 0], [0, 2e-3, 0], [0, 0, 3e-4]]  # [kg m^2], about the centre of mass, along the mesh's axes

What is not given is that of uniform density; without mass and density, the mass is unknown.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import trimesh
from pydantic import BeforeValidator, Field
from scipy.spatial import ConvexHull, QhullError

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import MeshError, OptionError
from regrasp_opt.schemas import Section, read_toml, validated

SAME = 1e-6
"""Share by which two values of one quantity, and metres by which two centres of mass, may differ and be the same."""

Positive = Annotated[float, Field(gt=0)]
Vector = Annotated[
    tuple[float, float, float], BeforeValidator(lambda v: v.tolist() if isinstance(v, np.ndarray) else v)
]
Matrix = Annotated[
    tuple[Vector, Vector, Vector], BeforeValidator(lambda v: v.tolist() if isinstance(v, np.ndarray) else v)
]


class MassProperties(Section):
    """What was given of an object's mass properties; None where nothing was.

    Attributes
    ----------
    mass : float, optional
        [kg]
    density : float, optional
        Mass over the volume of the mesh [kg/m^3]; takes the place of the mass.
    center_of_mass : (3,), optional
        In the object frame [m].
    inertia : (3, 3), optional
        About the centre of mass, along the axes of the object frame [kg m^2].
    """

    mass: Positive | None = None
    density: Positive | None = None
    center_of_mass: Vector | None = None
    inertia: Matrix | None = None

    def given(self) -> dict[str, Any]:
        """Return what was given, by name."""
        return self.model_dump(include=set(MassProperties.model_fields), exclude_none=True, mode="json")


NOTHING_GIVEN = MassProperties()


class _File(MassProperties):
    schema_: Literal[1] = Field(alias="schema")


def mass_properties(given: dict[str, Any], mesh: trimesh.Trimesh, path: Path | None, name: str) -> MassProperties:
    """Return the mass properties of an object, those `given` as arguments and those in the file beside its mesh.

    Parameters
    ----------
    given : dict
        Fields of `MassProperties`; None where nothing is given.
    mesh : trimesh.Trimesh
        The solid [m].
    path : Path or None
        Its file; None for a built-in object.
    name : str
        Of the object, for messages.

    Raises
    ------
    OptionError
        If a value is wrong, the two sources disagree, the centre of mass is not inside the convex hull of `mesh`, or
        no rigid body there has that inertia.
    """
    found = validated(given, MassProperties, f"mass properties of '{name}'", OptionError)
    file = None if path is None else path.with_suffix(".toml")
    if file is not None and file.is_file():
        found = _merged(found, _read(file), file, name)
    if found.given():
        _check(found, mesh, name)
    return found


def _read(file: Path) -> MassProperties:
    try:
        text = file.read_text("utf-8")
    except (OSError, ValueError) as error:
        raise OptionError(f"the mass properties in '{file}' cannot be read; give a TOML file in UTF-8") from error
    return read_toml(text, _File, f"mass properties in '{file}'", OptionError)


def _merged(given: MassProperties, filed: MassProperties, file: Path, name: str) -> MassProperties:
    """Return both together; they may not contradict each other."""
    ours, theirs = given.given(), filed.given()
    for key in ours.keys() & theirs.keys():
        if not np.allclose(ours[key], theirs[key], rtol=SAME, atol=SAME**2):
            raise OptionError(
                f"{key} of '{name}' is given as {ours[key]} but is {theirs[key]} in '{file}'; omit it or change the "
                "file"
            )
    return MassProperties(**theirs | ours)


def _check(found: MassProperties, mesh: trimesh.Trimesh, name: str) -> None:
    volume = float(mesh.volume)
    if found.mass is not None and found.density is not None and abs(found.density * volume / found.mass - 1) > SAME:
        raise OptionError(
            f"mass {found.mass:g} kg and density {found.density:g} kg/m3 of '{name}' disagree, since its volume is "
            f"{volume:.4g} m3; give one of them"
        )
    center = np.array(mesh.center_mass if found.center_of_mass is None else found.center_of_mass)
    try:
        hull = ConvexHull(np.asarray(mesh.vertices) - center)
    except QhullError as error:
        raise MeshError("the mesh is flat and has no convex hull; give a solid") from error
    if hull.equations[:, 3].max() > -SAME:
        raise OptionError(
            f"the centre of mass of '{name}', at ({', '.join(f'{x:g}' for x in center)}) m, is not inside its convex "
            "hull; give it in metres, in the frame of the mesh"
        )
    if found.inertia is None:
        return
    if found.mass is None and found.density is None:
        raise OptionError(f"the inertia of '{name}' is given without a mass; give its mass or density, too")
    _check_inertia(np.array(found.inertia), found.mass or (found.density or 0.0) * volume, hull.points, name)


def _check_inertia(inertia: FloatArray, mass: float, points: FloatArray, name: str) -> None:
    r"""Refuse an inertia that no distribution of `mass` within the hull of `points` (V, 3), about their origin, has.

    The second moments :math:`\Sigma = \frac{1}{2} \mathrm{tr}(I) 1 - I` are not negative, which is the triangle
    inequality of the principal moments, and along a principal axis, on which the points reach from `-a` to `b`, at
    most `a b` times the mass (Bhatia and Davis, 2000).
    """
    if not np.allclose(inertia, inertia.T, rtol=0, atol=SAME * np.abs(inertia).max()):
        raise OptionError(f"the inertia of '{name}' is not symmetric; give the matrix about the centre of mass")
    moments, axes = np.linalg.eigh(inertia)
    text = ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] <= 0 or moments[2] > (1 + SAME) * (moments[0] + moments[1]):
        raise OptionError(
            f"the inertia of '{name}' is that of no rigid body: its principal moments are {text} kg m2, and each must "
            "be positive and at most the sum of the other two"
        )
    along = points @ axes
    if (moments.sum() / 2 - moments > (1 + SAME) * mass * -along.min(axis=0) * along.max(axis=0)).any():
        raise OptionError(
            f"the inertia of '{name}' is too large for {mass:g} kg within its hull: its principal moments are {text} "
            "kg m2; give it in kg m2, about the centre of mass"
        )
