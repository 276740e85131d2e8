"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from regrasp_opt.cli.completion import OBJECTS, names, stored

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
    typer.Option(
        help="Built-in workcell (nova2-w, nova2-r140, ...) or a TOML file.", autocompletion=stored("workcells")
    ),
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
GraspFrameOption = Annotated[
    str | None,
    typer.Option(help="Hand frame of the grasp file: a name, or APPROACH,CLOSING,TCP such as z,x,0.1034."),
]
GraspScaleOption = Annotated[float, typer.Option(help="Metres per unit of the grasp file, e.g. 0.001.")]
GraspQualityOption = Annotated[float | None, typer.Option(help="Least quality of a grasp, as the grasp file has it.")]
GraspNearOption = Annotated[
    str, typer.Option(metavar="METRES,DEGREES", help="How far a grasp without a width may be moved onto the object.")
]
