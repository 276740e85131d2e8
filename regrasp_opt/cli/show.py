"""`regrasp-opt show`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from regrasp_opt.cli.output import make_console, working
from regrasp_opt.errors import PlanFileError
from regrasp_opt.motion import MotionPlan
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.viz import Track, trace_candidates, track_of, write_plan_page


def run_show(path: Path, *, motion: Path | None, html: Path | None, port: int, candidates: str | None) -> int:
    """Write the page of a saved plan to `html`, or serve a live view on `port` until interrupted; return 0.

    With the file of a `motion` of the plan the slider runs over that. With the name of a refiner as `candidates` it
    plans once more and shows the refiner's candidates by iteration.
    """
    plan = RegraspPlan.load(path)
    track = None if motion is None else _track(plan, path, motion)
    trace = None
    if candidates is not None:
        with working(f"planning again with {candidates}"):
            trace = trace_candidates(plan, candidates)
    if html is not None:
        write_plan_page(plan, html, track, trace)
        make_console().print(f"written: {html}", markup=False, soft_wrap=True)
        return 0
    from regrasp_opt.viz.scene import plan_scene
    from regrasp_opt.viz.viewer import PlanViewer

    viewer = PlanViewer(plan_scene(plan, track, trace), port)
    make_console(stderr=True).print(f"open {viewer.url} in a browser; end with Ctrl+C", soft_wrap=True)
    try:
        viewer.wait()
    except KeyboardInterrupt:
        viewer.stop()
    return 0


def _track(plan: RegraspPlan, path: Path, file: Path) -> Track:
    motion = MotionPlan.load(file)
    if motion.plan.poses.shape != plan.poses.shape or not np.allclose(motion.plan.poses, plan.poses, atol=1e-9):
        raise PlanFileError(f"'{file}' is not a motion of the plan '{path}'; plan the motion again")
    if not motion.solved:
        raise PlanFileError(f"there is no motion to show in '{file}': {motion.reason}")
    return track_of(plan, motion.segments)
