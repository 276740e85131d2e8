"""The commands that make something of a plan, and measure: motion, show, export and bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from regrasp_opt.cli import interrupts, options
from regrasp_opt.cli.completion import EXPERIMENTS, REFINERS, names, stored


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
