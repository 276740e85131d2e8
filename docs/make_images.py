"""Make the picture of a plan that the README and the first page show: `python docs/make_images.py`.

It needs Chromium on the path; the figure is the same one that ``regrasp-opt plan --html`` writes.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.cli.poses import parse_pose
from regrasp_opt.viz.plan_page import plan_figure

IMAGES = Path(__file__).parent / "images"
WIDTH, HEIGHT = 1600, 450
START, GOAL = "1:0.26,0.40,-30", "0:-0.26,0.40,10"
CAPTIONS = (
    "pick at the start",
    "put down at the intermediate pose",
    "pick with another grasp",
    "put down at the goal",
)


def solve() -> RegraspPlan:
    """Return the plan of the picture: a bottle that lies on one side is to lie on the next."""
    problem = RegraspProblem.load("bottle", "nova2-w")
    ends = [parse_pose(text, "pose", problem.placement_poses) for text in (START, GOAL)]
    return solve_sequence(problem, *ends)


def panels(plan: RegraspPlan) -> go.Figure:
    """Return one panel for each pick and each place of a plan with one regrasp."""
    page = plan_figure(plan)
    fixed = page.data[len(page.frames[0].data) :]
    figure = make_subplots(
        cols=len(page.frames),
        specs=[[{"type": "scene"}] * len(page.frames)],
        subplot_titles=[f"{i}. {caption}" for i, caption in enumerate(CAPTIONS, start=1)],
        horizontal_spacing=0.0,
    )
    for column, frame in enumerate(page.frames, start=1):
        for trace in (*frame.data, *fixed):
            shown = go.Mesh3d(trace)
            shown.showlegend = column == 1 and trace.name in ("start", "pose 1", "goal")
            shown.opacity = trace.opacity if trace.name != "table" else 0.9
            figure.add_trace(shown, row=1, col=column)
    hidden = {axis: {"visible": False} for axis in ("xaxis", "yaxis", "zaxis")}
    camera = {"eye": {"x": 0.12, "y": 1.08, "z": 0.62}, "center": {"x": 0.0, "y": -0.06, "z": -0.06}}
    figure.update_scenes(aspectmode="data", camera=camera, **hidden)
    figure.update_layout(
        width=WIDTH,
        height=HEIGHT,
        font={"size": 19},
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
        legend={"orientation": "h", "x": 0.5, "xanchor": "center", "y": 0.0, "itemsizing": "constant"},
        paper_bgcolor="white",
    )
    figure.update_annotations(font_size=22)
    return figure


def screenshot(figure: go.Figure, path: Path) -> None:
    """Draw `figure` in a headless browser and save it as PNG."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("Chromium is not on the path; install it, for example with 'apt-get install chromium'")
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        page.write_text(figure.to_html(include_plotlyjs=True, config={"displayModeBar": False}), encoding="utf-8")
        options = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--use-gl=angle", "--use-angle=swiftshader"]
        options += ["--enable-unsafe-swiftshader", f"--window-size={WIDTH},{HEIGHT}", "--virtual-time-budget=20000"]
        command = [browser, *options, f"--user-data-dir={folder}/profile", f"--screenshot={path}", page.as_uri()]
        subprocess.run(command, check=True, timeout=120, stderr=subprocess.DEVNULL)


def main() -> None:
    """Write ``docs/images/plan.png``."""
    IMAGES.mkdir(exist_ok=True)
    plan = solve()
    print(plan.status.name, np.round(plan.xi, 3).tolist())
    screenshot(panels(plan), IMAGES / "plan.png")


if __name__ == "__main__":
    main()
