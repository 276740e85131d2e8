"""`regrasp-opt show`."""

from __future__ import annotations

import json
import logging
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from regrasp_opt.cli.output import make_console, say_written, working
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
    """Write the page and the plots that are asked for, or serve the page until interrupted; return 0.

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
        with TemporaryDirectory() as folder:
            with working("drawing"):
                write_plan_page(plan, Path(folder) / "index.html", track, trace)
            _serve(folder, port, as_json)
        return 0
    written: list[Path] = []
    with working("drawing"):
        if html is not None:
            write_plan_page(plan, html, track, trace)
            written.append(html)
        if plots is not None:
            from regrasp_opt.viz.plots import write_plan_plots

            written += write_plan_plots(plan, trace, plots)
    if as_json:
        drawn = [str(path) for path in written if path != html]
        print(json.dumps({"html": None if html is None else str(html), "plots": drawn}))
        return 0
    say_written(*written)
    return 0


class _Handler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *arguments: object) -> None:
        logger.info(format, *arguments)


def _serve(folder: str, port: int, as_json: bool) -> None:
    """Serve `folder` to this machine alone until interrupted, at `port`, or at a free one if that is in use."""
    handler = partial(_Handler, directory=folder)
    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), handler)
    except OSError:
        server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    with server, suppress(KeyboardInterrupt):
        url = f"http://127.0.0.1:{server.server_port}"
        if as_json:
            print(json.dumps({"url": url}), flush=True)
        make_console(stderr=True).print(f"open {url} in a browser; end with Ctrl+C", soft_wrap=True)
        server.serve_forever()


def _track(plan: RegraspPlan, path: Path, file: Path) -> Track:
    motion = MotionPlan.load(file)
    if motion.plan.poses.shape != plan.poses.shape or not np.allclose(motion.plan.poses, plan.poses, atol=1e-9):
        raise PlanFileError(f"'{file}' is not a motion of the plan '{path}'; plan the motion again")
    if not motion.solved:
        raise PlanFileError(f"there is no motion to show in '{file}': {motion.reason}")
    return track_of(plan, motion.segments)
