"""`regrasp-opt show`."""

from __future__ import annotations

from pathlib import Path

from regrasp_opt.cli.output import make_console
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.viz import write_plan_page


def run_show(path: Path, *, html: Path | None, port: int) -> int:
    """Write the page of a saved plan to `html`, or serve a live view on `port` until interrupted; return 0."""
    plan = RegraspPlan.load(path)
    if html is not None:
        write_plan_page(plan, html)
        make_console().print(f"written: {html}", markup=False, soft_wrap=True)
        return 0
    from regrasp_opt.viz.scene import plan_scene
    from regrasp_opt.viz.viewer import PlanViewer

    viewer = PlanViewer(plan_scene(plan), port)
    make_console(stderr=True).print(f"open {viewer.url} in a browser; end with Ctrl+C", soft_wrap=True)
    try:
        viewer.wait()
    except KeyboardInterrupt:
        viewer.stop()
    return 0
