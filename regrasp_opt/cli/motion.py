"""`regrasp-opt motion`."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
from rich.markup import escape

from regrasp_opt.cli.output import make_console, plain_table, working
from regrasp_opt.io.mjcf_export import save_mjcf
from regrasp_opt.io.moveit_export import save_moveit
from regrasp_opt.io.ros_export import save_ros
from regrasp_opt.motion import MotionOptions, MotionPlan, plan_motion
from regrasp_opt.motion.trajectory.motion_plan import check_step
from regrasp_opt.motion.trajectory.scene_export import save_scene
from regrasp_opt.planning import RegraspPlan

logger = logging.getLogger(__name__)


def run_motion(path: Path, options: MotionOptions, files: dict[str, Path | None], *, step: float, as_json: bool) -> int:
    """Plan the motion of a saved plan, write the `files` asked for by option, and return 0 if there is one, else 1."""
    check_step(step)
    plan, asked = RegraspPlan.load(path), {option: file for option, file in files.items() if file is not None}
    if "scene" in asked:
        save_scene(plan, asked["scene"])
    with working("planning the motion"):
        motion = plan_motion(plan, options)
    logger.info("%s; planned in %.2f s with %s", motion.status.name.lower(), motion.seconds, options)
    if "out" in asked:
        motion.save(asked["out"])
    if motion.solved:
        if "csv" in asked:
            motion.save_csv(asked["csv"], step)
        for option, save in (("ros", save_ros), ("moveit", save_moveit), ("mjcf", save_mjcf)):
            if option in asked:
                save(motion, asked[option])
    if as_json:
        print(json.dumps(summary(motion)))
    else:
        show(motion)
    return 0 if motion.solved else 1


def summary(motion: MotionPlan) -> dict[str, object]:
    """Return what ``--json`` prints."""
    return {
        "status": motion.status.name.lower(),
        "reason": motion.reason,
        "duration": motion.duration,
        "seconds": motion.seconds,
        "segments": [
            {
                "phase": s.phase.name.lower(),
                "transition": s.transition,
                "grasp_id": s.grasp_id,
                "duration": s.trajectory.duration,
            }
            for s in motion.segments
        ],
    }


def show(motion: MotionPlan) -> None:
    """Print the segments, or why there are none."""
    console = make_console()
    if not motion.solved:
        console.print(f"[bold red]{motion.status.name}[/]: {motion.status.value}")
        console.print(escape(motion.reason), soft_wrap=True)
        return
    numbers = "from [s]", "takes [s]", "joint travel [rad]", "peak speed"
    table = plain_table("move", "grasp", "phase", *numbers, right=len(numbers))
    for s, start in zip(motion.segments, motion.starts.tolist(), strict=True):
        travel = float(np.abs(np.diff(s.trajectory.positions, axis=0)).sum(axis=0).max())
        peak = float((s.trajectory.peak_velocity() / motion.velocity_limits).max())
        figures = (f"{value:.2f}" for value in (start, s.trajectory.duration, travel))
        table.add_row(str(s.transition), str(s.grasp_id), s.phase.name.lower(), *figures, f"{100 * peak:.0f} %")
    console.print(table)
    console.print(f"[bold green]SOLVED[/]: {len(motion.segments)} segments, {motion.duration:.1f} s of motion")
