"""The commands that plan and prepare, and what they take: plan, prepare, inspect and check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from regrasp_opt.cli import interrupts, options
from regrasp_opt.cli.completion import OBJECTS, names, stored
from regrasp_opt.errors import OptionError


def plan(
    object: options.ObjectOption = "bottle",
    workcell: options.WorkcellOption = "nova2-w",
    end_effector: options.EffectorOption = None,
    start: options.PoseOption = None,
    goal: options.PoseOption = None,
    tolerance: options.ToleranceOption = "0.005,3",
    symmetry: options.SymmetryOption = False,
    refiner: options.RefinerOption = "ipopt",
    seed: options.SeedOption = 0,
    max_regrasps: Annotated[int, typer.Option(help="Largest number of intermediate poses.")] = 5,
    num_regrasps: Annotated[int | None, typer.Option(help="Exactly this number of them instead.")] = None,
    placements: options.PlacementsOption = None,
    supports: options.SupportsOption = None,
    from_above: options.FromAboveOption = None,
    alternatives: Annotated[int, typer.Option(help="Further plans to look for, which differ from the first.")] = 0,
    time_limit: Annotated[float | None, typer.Option(help="Longest time to search \\[s].")] = None,
    model: options.ModelOption = None,
    grasps: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Grasps to plan with: .npz, .csv, .h5, .json or .yaml.")
    ] = None,
    grasp_frame: options.GraspFrameOption = None,
    grasp_scale: options.GraspScaleOption = 1.0,
    grasp_quality: options.GraspQualityOption = None,
    grasp_near: options.GraspNearOption = "0.005,5",
    obstacles: options.ObstaclesOption = None,
    obstacle_frame: options.ObstacleFrameOption = None,
    scale: options.ScaleOption = 1.0,
    repair: options.RepairOption = False,
    thickness: options.ThicknessOption = None,
    mass: options.MassOption = None,
    density: options.DensityOption = None,
    center_of_mass: options.CenterOption = None,
    inertia: options.InertiaOption = None,
    explain: Annotated[bool, typer.Option("--explain", help="Where there is no plan, try what would help.")] = False,
    out: Annotated[Path | None, typer.Option(help="Save the plan as JSON.")] = None,
    html: Annotated[Path | None, typer.Option(help="Save a page that shows the plan.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the plan as one JSON object.")] = False,
) -> int:
    """Plan from a start to a goal pose. An end that is not given is drawn at random, such that a regrasp is needed.

    For example:

    regrasp-opt plan

    regrasp-opt plan --object mug --start 0:-0.2,0.4,30 --goal 1:0.25,0.3,180 --out plan.json

    regrasp-opt plan --object part.stl --workcell my-cell.toml --html plan.html
    """
    from regrasp_opt.cli.grasps import given_grasps
    from regrasp_opt.cli.plan import run_plan
    from regrasp_opt.io.scene_files import read_obstacles
    from regrasp_opt.planning import RegraspProblem

    given = given_grasps(grasps, grasp_frame, grasp_scale, grasp_quality, grasp_near)
    given |= options.of_object(scale, repair, thickness, mass, density, center_of_mass, inertia)
    problem = RegraspProblem.load(object, workcell, end_effector=end_effector, model=model, **given)
    if obstacles is not None:
        problem = problem.with_obstacles(read_obstacles(obstacles, problem.workcell, frame=obstacle_frame))
    search = {"refiner": refiner, "max_regrasps": max_regrasps, "seed": seed, "time_limit": time_limit}
    search |= {"tolerance": options.tolerance_of(tolerance), "symmetry": symmetry}
    search |= {"num_regrasps": num_regrasps, "alternatives": alternatives}
    search |= options.search_filter(placements, supports, from_above)
    return run_plan(problem, start, goal, search, explain=explain, out=out, html=html, as_json=json)


def _was_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def prepare(
    context: typer.Context,
    workcell: Annotated[
        str,
        typer.Argument(
            metavar="WORKCELL", help="Built-in workcell or a TOML file.", autocompletion=stored("workcells")
        ),
    ],
    object: Annotated[
        str | None,
        typer.Option("--object", help="Train an energy of this object instead.", autocompletion=names(OBJECTS)),
    ] = None,
    end_effector: options.EffectorOption = None,
    poses: Annotated[int | None, typer.Option(help="Tool poses to train the arm's energy on.")] = None,
    samples: Annotated[int, typer.Option(help="Feasible (pose, grasp) pairs to train an object's on.")] = 20_000,
    grasps: Annotated[
        str, typer.Option(metavar="COUNT|FILE", help="Number of candidate grasps of the object, or a file of them.")
    ] = "200",
    grasp_frame: options.GraspFrameOption = None,
    grasp_scale: options.GraspScaleOption = 1.0,
    grasp_quality: options.GraspQualityOption = None,
    grasp_near: options.GraspNearOption = "0.005,5",
    seed: options.SeedOption = 0,
    jobs: Annotated[int, typer.Option(help="Worker processes; -1 uses all cores.")] = -1,
    scale: options.ScaleOption = 1.0,
    repair: options.RepairOption = False,
    thickness: options.ThicknessOption = None,
    mass: options.MassOption = None,
    density: options.DensityOption = None,
    center_of_mass: options.CenterOption = None,
    inertia: options.InertiaOption = None,
    out: Annotated[Path | None, typer.Option(help="File (or folder, of an object's model) to write.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the report as one JSON object.")] = False,
) -> int:
    """Train the energy of a workcell's arm, for any object. 'plan' does it by itself where none is there.

    With --object, train an energy of one object in this workcell, as in the paper; an interrupted run resumes.

    For example:

    regrasp-opt prepare my-cell.toml

    regrasp-opt prepare nova2-w --object part.stl
    """
    of_grasps = ("grasps", "grasp_frame", "grasp_scale", "grasp_quality", "grasp_near")
    of_object = ("scale", "repair", "thickness", "mass", "density", "center_of_mass", "inertia")
    foreign = ("samples", *of_grasps, *of_object) if object is None else ("poses",)
    given = next((name.replace("_", "-") for name in foreign if _was_given(context, name)), None)
    if given is not None:
        other = "an arm; omit it, or give --object" if object is None else "an object; omit it, or omit --object"
        raise OptionError(f"--{given} has no meaning for the energy of {other}")
    from regrasp_opt.cli.grasps import given_grasps
    from regrasp_opt.cli.prepare import run_prepare, run_prepare_object
    from regrasp_opt.objects import load_object
    from regrasp_opt.scene import load_workcell

    cell = load_workcell(workcell, end_effector=end_effector)
    if object is None:
        return run_prepare(cell, json, poses=poses, out=out, seed=seed, jobs=jobs)
    interrupts.resumable()
    body = load_object(object, **options.of_object(scale, repair, thickness, mass, density, center_of_mass, inertia))
    candidates = given_grasps(grasps, grasp_frame, grasp_scale, grasp_quality, grasp_near)
    return run_prepare_object(body, cell, json, samples=samples, out=out, seed=seed, jobs=jobs, **candidates)


def inspect(
    workcell: Annotated[
        str | None,
        typer.Option(help="Built-in workcell or a TOML file.", autocompletion=stored("workcells")),
    ] = None,
    object: Annotated[
        str | None, typer.Option("--object", help="Built-in object or a mesh file.", autocompletion=names(OBJECTS))
    ] = None,
    end_effector: options.EffectorOption = None,
    scale: options.ScaleOption = 1.0,
    repair: options.RepairOption = False,
    thickness: options.ThicknessOption = None,
    mass: options.MassOption = None,
    density: options.DensityOption = None,
    center_of_mass: options.CenterOption = None,
    inertia: options.InertiaOption = None,
    pose: Annotated[str | None, typer.Option(metavar="POSE", help="Say why grasps fail at this pose.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page that shows the workcell and the object.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the description as one JSON object.")] = False,
) -> int:
    """Show how a workcell, an object and the grasps for both were understood.

    For example:

    regrasp-opt inspect --workcell my-cell.toml

    regrasp-opt inspect --object part.stl --workcell my-cell.toml --html cell.html
    """
    from regrasp_opt.cli.inspect import run_inspect

    if html is not None or pose is not None or (workcell is None and object is None):
        workcell, object = workcell or "nova2-w", object or "bottle"
    mesh = options.of_object(scale, repair, thickness, mass, density, center_of_mass, inertia)
    return run_inspect(workcell, object, mesh, {"end_effector": end_effector}, pose, html=html, as_json=json)


def check(
    plan: options.PlanArgument,
    json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> int:
    """Verify a saved plan again from problem data alone; if a claim does not hold, exit with 1 and name it.

    Example:

    regrasp-opt check plan.json
    """
    from regrasp_opt.cli.check import run_check

    return run_check(plan, as_json=json)
