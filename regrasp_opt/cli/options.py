"""Options that several commands have."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from regrasp_opt.cli.completion import OBJECTS, REFINERS, names, stored
from regrasp_opt.errors import OptionError

ObjectOption = Annotated[
    str,
    typer.Option(
        "--object",
        help="Built-in object (bottle, mug, pentagon, figurine) or a mesh file.",
        autocompletion=names(OBJECTS),
    ),
]
WorkcellOption = Annotated[
    str,
    typer.Option(help="Built-in workcell (nova2-w, panda-w, ...) or a TOML file.", autocompletion=stored("workcells")),
]
EffectorOption = Annotated[
    str | None,
    typer.Option("--end-effector", help="Replace the workcell's end-effector.", autocompletion=stored("end_effectors")),
]
ModelOption = Annotated[Path | None, typer.Option(help="Energy of the arm, or folder of a prepared object.")]
ScaleOption = Annotated[float, typer.Option(help="Metres per unit of the mesh file, e.g. 0.001.")]
RepairOption = Annotated[bool, typer.Option("--repair", help="Repair the mesh where that is safe.")]
ThicknessOption = Annotated[float | None, typer.Option(help="Thickness for sheets in the mesh file \\[m].")]
SeedOption = Annotated[int, typer.Option(help="Random seed; the same seed gives the same result.")]
PlanArgument = Annotated[Path, typer.Argument(metavar="PLAN", help="A plan file.", show_default=False)]
PlacementsOption = Annotated[
    str | None, typer.Option(metavar="M,M,...", help="Placements that intermediate poses may have.")
]
SupportsOption = Annotated[
    str | None, typer.Option(metavar="NAME,...", help="Supports that intermediate poses may be on.")
]
FromAboveOption = Annotated[
    float | None, typer.Option(metavar="DEG", help="Grasp from above only, to within this angle \\[degrees].")
]
GraspFrameOption = Annotated[
    str | None,
    typer.Option(help="Hand frame of the grasp file: a name, or APPROACH,CLOSING,TCP such as z,x,0.1034."),
]
GraspScaleOption = Annotated[float, typer.Option(help="Metres per unit of the grasp file, e.g. 0.001.")]
GraspQualityOption = Annotated[float | None, typer.Option(help="Least quality of a grasp, as the grasp file has it.")]
GraspNearOption = Annotated[
    str, typer.Option(metavar="METRES,DEGREES", help="How far a grasp without a width may be moved onto the object.")
]
RefinerOption = Annotated[
    str,
    typer.Option(
        help="ipopt, lattice, langevin, langevin-ipopt, paper, or exact, which needs no energy.",
        autocompletion=names(REFINERS),
    ),
]
ObstaclesOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Obstacles besides the workcell's: TOML, MoveIt's .scene or .yaml, or MJCF."),
]
ObstacleFrameOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Frame of a .scene or MJCF file: world, or the robot's root link."),
]
PoseOption = Annotated[
    str | None,
    typer.Option(
        metavar="POSE",
        help="\\[SUPPORT/]PLACEMENT:x,y,yaw_deg, FIXTURE/POSE, or JSON, also in a file: a 4x4 matrix, or position and "
        "quaternion_xyzw (or wxyz).",
    ),
]
ToleranceOption = Annotated[
    str, typer.Option(metavar="M,DEG", help="How far start and goal may be from rest \\[m, degrees].")
]
SymmetryOption = Annotated[
    bool, typer.Option("--symmetry", help="Goals that differ by a turn about the object's axis of symmetry are equal.")
]
MassOption = Annotated[float | None, typer.Option(help="Mass of the object \\[kg].")]
DensityOption = Annotated[float | None, typer.Option(help="Or its density \\[kg/m^3].")]
CenterOption = Annotated[
    str | None, typer.Option("--center-of-mass", metavar="X,Y,Z", help="Its centre of mass, in the mesh's frame \\[m].")
]
InertiaOption = Annotated[
    str | None,
    typer.Option(metavar="XX,XY,XZ,YY,YZ,ZZ", help="Its inertia about the centre of mass, mesh's axes \\[kg m^2]."),
]


def of_object(
    scale: float,
    repair: bool,
    thickness: float | None,
    mass: float | None,
    density: float | None,
    center_of_mass: str | None,
    inertia: str | None,
) -> dict[str, Any]:
    """Return the options of `load_object`.

    Raises
    ------
    OptionError
        If `center_of_mass` is not three numbers, or `inertia` not six.
    """
    center = None if center_of_mass is None else _numbers("center-of-mass", center_of_mass, 3)
    options = {"scale": scale, "repair": repair, "thickness": thickness, "mass": mass, "density": density}
    rows = None
    if inertia is not None:
        xx, xy, xz, yy, yz, zz = _numbers("inertia", inertia, 6)
        rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    return {**options, "center_of_mass": center, "inertia": rows}


def search_filter(placements: str | None, supports: str | None, from_above: float | None) -> dict[str, Any]:
    """Return the options of `solve_sequence` that say what a search may use.

    Raises
    ------
    OptionError
        If `placements` are not whole numbers, or the angle `from_above` is not between 0 and 180 degrees.
    """
    chosen: dict[str, Any] = {}
    if placements is not None:
        parts = placements.split(",")
        if not all(part.strip().isdecimal() and part.strip().isascii() for part in parts):
            raise OptionError(f"--placements is '{placements}'; give whole numbers with commas between them")
        chosen["placements"] = [int(part) for part in parts]
    if supports is not None:
        chosen["supports"] = [name.strip() for name in supports.split(",")]
    if from_above is not None:
        if not 0 < from_above <= 180:
            raise OptionError(f"--from-above is {from_above}; give an angle above 0, at most 180 degrees")
        from regrasp_opt.planning.filters import from_above as grasps_from_above

        chosen["grasps"] = grasps_from_above(math.radians(from_above))
    return chosen


def tolerance_of(text: str) -> tuple[float, float]:
    """Return a distance [m] and an angle [rad] that are typed in metres and degrees."""
    distance, degrees = _numbers("tolerance", text, 2)
    return distance, math.radians(degrees)


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise OptionError(f"--{option} is '{text}'; give {count} numbers with commas between them")
    return numbers
