"""`regrasp-opt show`."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from regrasp_opt.cli.output import make_console, working
from regrasp_opt.errors import PlanFileError
from regrasp_opt.motion import MotionPlan
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.viz import Track, trace_candidates, track_of, write_plan_page

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ShowRequest:
    """The options of `regrasp-opt show`."""

    plan: Path
    motion: Path | None
    candidates: str | None
    html: Path | None
    plots: Path | None
    port: int


def run_show(request: ShowRequest, *, as_json: bool) -> int:
    """Write the page and the plots that are asked for, or serve a live view until interrupted; return 0.

    With the file of a motion the slider runs over that. With the name of a refiner as `candidates` it plans once more
    and shows that refiner's candidates by iteration.
    """
    plan = RegraspPlan.load(request.plan)
    track = None if request.motion is None else _track(plan, request.plan, request.motion)
    trace = None
    if request.candidates is not None:
        with working(f"planning again with {request.candidates}"):
            trace = trace_candidates(plan, request.candidates)
        logger.info("%d candidates in %d frames", *trace.cost.T.shape)
    if request.html is None and request.plots is None:
        from regrasp_opt.viz.scene import plan_scene
        from regrasp_opt.viz.viewer import PlanViewer

        with working("drawing"):
            viewer = PlanViewer(plan_scene(plan, track, trace), request.port)
        if as_json:
            print(json.dumps({"url": viewer.url}), flush=True)
        make_console(stderr=True).print(f"open {viewer.url} in a browser; end with Ctrl+C", soft_wrap=True)
        try:
            viewer.wait()
        except KeyboardInterrupt:
            viewer.stop()
        return 0
    plots: list[Path] = []
    with working("drawing"):
        if request.html is not None:
            write_plan_page(plan, request.html, track, trace)
        if request.plots is not None:
            from regrasp_opt.cli.plots import write_plan_plots

            plots = write_plan_plots(plan, trace, request.plots)
    written = [path for path in (request.html, *plots) if path is not None]
    if as_json:
        html = None if request.html is None else str(request.html)
        print(json.dumps({"html": html, "plots": [str(path) for path in plots]}))
        return 0
    for path in written:
        make_console().print(f"written: {path}", markup=False, soft_wrap=True)
    return 0


def _track(plan: RegraspPlan, path: Path, file: Path) -> Track:
    motion = MotionPlan.load(file)
    if motion.plan.poses.shape != plan.poses.shape or not np.allclose(motion.plan.poses, plan.poses, atol=1e-9):
        raise PlanFileError(f"'{file}' is not a motion of the plan '{path}'; plan the motion again")
    if not motion.solved:
        raise PlanFileError(f"there is no motion to show in '{file}': {motion.reason}")
    return track_of(plan, motion.segments)
