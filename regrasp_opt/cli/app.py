"""The commands and their options. Heavy modules are imported by the command that needs them, so `--help` is instant."""

from __future__ import annotations

import logging
import os
import platform
import sys
import time
import traceback
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

import typer

from regrasp_opt.cli import interrupts, options
from regrasp_opt.cli.completion import EXPERIMENTS, OBJECTS, REFINERS, names, stored
from regrasp_opt.errors import OptionError, RegraspError
from regrasp_opt.files import data_home

logger = logging.getLogger(__name__)

app = typer.Typer(
    name="regrasp-opt",
    help="Plan regrasps: the intermediate poses at which a robot must put an object down to get it from start to goal.",
    invoke_without_command=True,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
_state = {"debug": False}


def run(arguments: list[str]) -> int:
    """Run the command line on `arguments` and return the exit code."""
    began = time.perf_counter()
    if any(not word or (word.startswith("--") and word.find("=") == len(word) - 1) for word in arguments):
        return _fail("an argument is empty, perhaps because a variable is not set; give it a value, or omit it")
    try:
        result = app(args=arguments, standalone_mode=False)
    except typer.TyperException as error:
        return _fail(error.format_message(), error)
    except RegraspError as error:
        return _fail(str(error), error)
    except OSError as error:
        return _fail(f"{error.strerror or error}: {error.filename}" if error.filename else str(error), error)
    except MemoryError as error:
        return _fail("there is not enough memory for this; ask for fewer samples, grasps or regrasps", error)
    except Exception as error:  # the last resort: a defect of ours must not spill a traceback either
        return _fail(f"internal error ({type(error).__name__}: {error}); run again with --debug and report it", error)
    except KeyboardInterrupt:
        return interrupts.conclude()
    logger.info("took %.2f s", time.perf_counter() - began)
    if interrupts.received():  # Typer makes an exit code of it
        return interrupts.conclude()
    return result if isinstance(result, int) else 0


def _fail(message: str, error: BaseException | None = None) -> int:
    if interrupts.received():  # what a library made of the interrupt that it caught
        return interrupts.conclude()
    if _state["debug"] and error is not None:
        traceback.print_exception(error)
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return 2


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"regrasp-opt {version('regrasp-opt')}")
        raise typer.Exit()


@app.callback()
def _common(
    context: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log each step to stderr.")] = False,
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    _state["debug"] = debug or bool(os.environ.get("REGRASP_OPT_DEBUG"))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, format="%(name)s: %(message)s")
    system = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    logger.info("regrasp-opt %s, %s, data in %s", version("regrasp-opt"), system, data_home())
    if context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
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
    return run_plan(problem, start, goal, search, explain=explain, out=out, html=html, as_json=json)


def _was_given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


@app.command()
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


@app.command()
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


@app.command()
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


@app.command()
def motion(
    plan: options.PlanArgument,
    out: Annotated[Path | None, typer.Option(help="Save the motion as JSON.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Save the motion of joints and jaw over time as CSV.")] = None,
    step: Annotated[float, typer.Option(help="Time between rows of the CSV \\[s].")] = 0.01,
    scene: Annotated[Path | None, typer.Option(help="Folder to write the scene to, as URDF.")] = None,
    ros: Annotated[Path | None, typer.Option(help="Save ROS 2 goals of arm and gripper as YAML.")] = None,
    moveit: Annotated[Path | None, typer.Option(help="Save MoveIt's planning scenes as YAML.")] = None,
    mjcf: Annotated[Path | None, typer.Option(help="Folder to write a model and the motion to, for MuJoCo.")] = None,
    velocity: Annotated[float, typer.Option(help="Fraction of the joints' velocity limits to use, 0.001 to 1.")] = 1.0,
    acceleration: Annotated[float, typer.Option(help="Largest joint acceleration \\[rad/s^2], 0.001 to 1000.")] = 5.0,
    jerk: Annotated[float | None, typer.Option(help="Largest joint jerk \\[rad/s^3], 0.1 to 100,000.")] = None,
    squeeze: Annotated[float, typer.Option(help="How far below contact the jaw is told to close \\[m].")] = 0.004,
    force: Annotated[float | None, typer.Option(help="Force with which the jaw is told to close \\[N].")] = None,
    no_home: Annotated[bool, typer.Option("--no-home", help="Do not begin and end at the robot's home.")] = False,
    seed: options.SeedOption = 0,
    json: Annotated[bool, typer.Option("--json", help="Print a summary as one JSON object.")] = False,
) -> int:
    """Plan the arm's motion for a saved plan: joint trajectories, verified free of collision over their whole length.

    Example:

    regrasp-opt motion plan.json --out motion.json --csv motion.csv
    """
    from regrasp_opt.cli.motion import run_motion
    from regrasp_opt.motion import MotionOptions

    home = None if no_home else "robot"
    how = MotionOptions(home, velocity, acceleration, jerk, squeeze=squeeze, force=force, seed=seed)
    files = {"out": out, "csv": csv, "scene": scene, "ros": ros, "moveit": moveit, "mjcf": mjcf}
    return run_motion(plan, how, files, step=step, as_json=json)


@app.command()
def show(
    plan: options.PlanArgument,
    motion: Annotated[Path | None, typer.Option(help="A motion of the plan, saved by 'motion --out'.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write one page that needs no network, and exit.")] = None,
    candidates: Annotated[
        str | None,
        typer.Option(
            metavar="REFINER",
            help="Plan again with this refiner and show its candidates by iteration.",
            autocompletion=names(REFINERS),
        ),
    ] = None,
    plots: Annotated[
        Path | None, typer.Option(help="Write plots of the cost and the candidates to this folder, and exit.")
    ] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to serve the page at.")] = 8080,
    json: Annotated[bool, typer.Option("--json", help="Print the files written, or the address, as JSON.")] = False,
) -> int:
    """Show a saved plan in the browser: a page, served until Ctrl+C or written to a file; or plot its cost.

    For example:

    regrasp-opt show plan.json

    regrasp-opt show plan.json --motion motion.json --html motion.html

    regrasp-opt show plan.json --candidates ipopt --html candidates.html --plots plots
    """
    from regrasp_opt.cli.show import run_show

    return run_show(plan, motion, candidates, html=html, plots=plots, port=port, as_json=json)


@app.command()
def export(
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL",
            help="Folder of a prepared model, or OBJECT-WORKCELL of a bundled one.",
            autocompletion=stored("models"),
        ),
    ],
    to: Annotated[Literal["casadi", "c", "onnx"], typer.Option("--to", help="Format.")],
    out: Annotated[Path | None, typer.Option(help="File to write; by default in the current folder.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the file written as one JSON object.")] = False,
) -> int:
    """Export the energy of all grasps as a function of an object pose.

    Example:

    regrasp-opt export bottle-nova2-w --to c --out energy.c
    """
    from regrasp_opt.cli.export import run_export

    return run_export(model, to, out, as_json=json)


@app.command()
def bench(
    experiment: Annotated[
        str,
        typer.Argument(
            metavar="EXPERIMENT",
            help="cost-sweep, one-step, unseen, cross-effector, multi-step, hard-tiers, refiners, ablations, "
            "joint, motion, any, arms or speed.",
            autocompletion=names(EXPERIMENTS),
        ),
    ],
    quick: Annotated[bool, typer.Option("--quick", help="Take minutes: smaller sizes than the paper's.")] = False,
    objects: Annotated[
        Path | None, typer.Option(help="Folder of meshes to evaluate besides the built-in ones.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Worker processes; -1 uses all cores.")] = -1,
    dask: Annotated[str | None, typer.Option(help="Address of a Dask scheduler whose workers to use.")] = None,
    seed: options.SeedOption = 0,
    out: Annotated[Path, typer.Option(help="Folder of the results; an interrupted run resumes there.")] = Path(
        "benchmarks"
    ),
    json: Annotated[bool, typer.Option("--json", help="Print the summary as one JSON object.")] = False,
) -> int:
    """Run an experiment, the paper's or ours, and write rows, a summary and a page. An interrupted run resumes.

    Example:

    regrasp-opt bench one-step --quick --out results
    """
    if experiment != "speed":  # timings start over
        interrupts.resumable()
    from regrasp_opt.benchmarks.harness.session import Session
    from regrasp_opt.cli.bench import run_bench

    session = Session(out, quick=quick, objects=objects, jobs=jobs, seed=seed)
    return run_bench(experiment, session, dask, as_json=json)
