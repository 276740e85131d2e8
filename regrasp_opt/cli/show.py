"""`regrasp-opt show`."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np

from regrasp_opt.cli.output import make_console, working
from regrasp_opt.errors import PlanFileError
from regrasp_opt.motion import MotionPlan
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.viz import Track, trace_candidates, track_of, write_plan_page

logger = logging.getLogger(__name__)


def run_show(
    file: Path,
    motion: Path | None,
    candidates: str | None,
    *,
    html: Path | None,
    plots: Path | None,
    port: int,
    as_json: bool,
) -> int:
    """Write the page and the plots that are asked for, or serve a live view until interrupted; return 0.

    With the file of a motion the slider runs over that. With the name of a refiner as `candidates` it plans once more
    and shows that refiner's candidates by iteration.
    """
    plan = RegraspPlan.load(file)
    track = None if motion is None else _track(plan, file, motion)
    trace = None
    if candidates is not None:
        with working(f"planning again with {candidates}"):
            trace = trace_candidates(plan, candidates)
        logger.info("%d candidates in %d frames", *trace.cost.T.shape)
    if html is None and plots is None:
        from regrasp_opt.viz.scene import plan_scene
        from regrasp_opt.viz.viewer import PlanViewer

        with working("drawing"):
            viewer = PlanViewer(plan_scene(plan, track, trace), port)
        if as_json:
            print(json.dumps({"url": viewer.url}), flush=True)
        make_console(stderr=True).print(f"open {viewer.url} in a browser; end with Ctrl+C", soft_wrap=True)
        try:
            viewer.wait()
        except KeyboardInterrupt:
            viewer.stop()
        return 0
    drawn: list[Path] = []
    with working("drawing"):
        if html is not None:
            write_plan_page(plan, html, track, trace)
        if plots is not None:
            from regrasp_opt.cli.plots import write_plan_plots

            drawn = write_plan_plots(plan, trace, plots)
    if as_json:
        print(json.dumps({"html": None if html is None else str(html), "plots": [str(path) for path in drawn]}))
        return 0
    for path in ([] if html is None else [html]) + drawn:
        make_console().print(f"written: {path}", markup=False, soft_wrap=True)
    return 0


def _track(plan: RegraspPlan, path: Path, file: Path) -> Track:
    motion = MotionPlan.load(file)
    if motion.plan.poses.shape != plan.poses.shape or not np.allclose(motion.plan.poses, plan.poses, atol=1e-9):
        raise PlanFileError(f"'{file}' is not a motion of the plan '{path}'; plan the motion again")
    if not motion.solved:
        raise PlanFileError(f"there is no motion to show in '{file}': {motion.reason}")
    return track_of(plan, motion.segments)
