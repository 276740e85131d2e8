"""Make the pictures of the README and the pages: `python docs/make_images.py`.

It needs the extras ``viz`` and ``dev``, Chromium and its driver on the path. The pictures are of the page that
``regrasp-opt plan --html`` writes.
"""

from __future__ import annotations

import base64
import io
import json
import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.by import By

from regrasp_opt import Recipe, RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import Instance
from regrasp_opt.benchmarks.paper.cost_sweep import COST_NAMES, sweep
from regrasp_opt.conventions import planar_transform
from regrasp_opt.planning.pose_text import parse_pose
from regrasp_opt.solvers import NlpRefiner
from regrasp_opt.viz import CandidateTrace, trace_candidates, write_plan_page
from regrasp_opt.viz.plots import plot_cost_landscape, plot_cost_traces, plot_pose_distribution

IMAGES, SCENES = (Path(__file__).parent / name for name in ("images", "scenes"))
START, GOAL = "1:0.26,0.40,-30", "0:-0.26,0.40,10"
HIDE_CARDS = "for (const card of document.querySelectorAll('.card')) card.style.display = 'none';"
BLOCKED = "0:0.26,0.38,20", "1:-0.26,0.40,10"
SWEPT = "0:0.29,0.47,70", "0:-0.39,0.55,0"
"""Ends on one side of the bottle that share no grasp."""
STYLES = [
    {"color": colour, "linestyle": dash}
    for colour, dash in zip(("#0072b2", "#d55e00", "#009e73", "#cc79a7"), ("-", "--", ":", "-."), strict=True)
]
"""Lines that differ in more than their hue."""
CAPTIONS = (
    "1. pick at the start",
    "2. put down at the intermediate pose",
    "3. pick with another grasp",
    "4. put down at the goal",
)


def solve() -> RegraspPlan:
    """Return the plan of the pictures: a bottle that lies on one side is to lie on the next."""
    problem = RegraspProblem.load("bottle", "nova2-w")
    ends = [parse_pose(text, "pose", problem) for text in (START, GOAL)]
    return solve_sequence(problem, *ends)


def open_browser(profile: str) -> webdriver.Chrome:
    """Return a headless Chromium."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    for option in ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars"):
        options.add_argument(option)
    for option in ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", f"--user-data-dir={profile}"):
        options.add_argument(option)
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    browser.set_script_timeout(300)
    return browser


def photograph(browser: webdriver.Chrome, width: int, height: int) -> Image.Image:
    """Return a picture of the page in a window of this size [px]."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
    shot = browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})
    return Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")


def draw_energy(problem: RegraspProblem, placement: int = 4, yaw: float = 0.0) -> Figure:
    """Return a picture of the energy of one grasp over the table, beside where the grasp is feasible in fact."""
    (x_low, y_low), (x_high, y_high) = problem.workcell.bounds.array
    x, y = np.meshgrid(np.linspace(x_low, x_high, 46), np.linspace(y_low, y_high, 26))
    xi = np.stack([x, y, np.full_like(x, yaw)], axis=-1)
    poses = planar_transform(xi) @ problem.placement_poses[placement]
    energy = problem.energy(poses)
    grasp = int(np.argmin(np.abs((energy < 1).mean(axis=(0, 1)) - 0.5)))
    here = np.array([grasp])
    feasible = np.array([[problem.checker.feasible(T, here)[0] for T in row] for row in poses])
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.4), layout="constrained", sharey=True)
    drawn = axes[0].pcolormesh(x, y, energy[..., grasp], vmin=0, vmax=10, cmap="viridis", shading="nearest")
    axes[0].contour(x, y, energy[..., grasp], [np.log(2)], colors="white")
    axes[0].set_title(f"energy of grasp {grasp}; white: probability 1/2")
    figure.colorbar(drawn, ax=axes[0], label="E(T, g)", extend="max")
    axes[1].pcolormesh(x, y, np.where(feasible, 0.0, 10.0), vmin=0, vmax=10, cmap="viridis", shading="nearest")
    axes[1].set_title("exact check; dark: feasible")
    for ax in axes:
        ax.set(xlabel="x [m]", aspect="equal")
    axes[0].set_ylabel("y [m]")
    figure.suptitle(f"{problem.object.name}, placement {placement}, turned by {np.degrees(yaw):.0f} degrees")
    return figure


def draw_chain(plan: RegraspPlan) -> Figure:
    """Return a picture of which grasps are feasible at the poses of a plan, and which are shared by neighbours."""
    feasible = np.array([plan.problem.feasible_grasps(T) for T in plan.poses])
    order = np.lexsort((~feasible).astype(int)[::-1])
    order = order[feasible[:, order].any(axis=0)]
    names = ["start", *(f"pose {k}" for k in range(1, plan.num_regrasps + 1)), "goal"]
    figure, ax = plt.subplots(figsize=(11, 2.4), layout="constrained")
    for row in range(len(names)):
        at = np.flatnonzero(feasible[row, order])
        ax.scatter(at, np.full(len(at), row), s=14, color="#0072b2", zorder=3)
    for row, transition in enumerate(plan.transitions):
        at = np.flatnonzero(np.isin(order, transition.grasp_ids))
        ax.vlines(at, row, row + 1, color="#d55e00", linewidth=1.5)
        ax.text(len(order) + 1, row + 0.5, f"{len(at)} shared", color="#d55e00", va="center")
    ax.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.6, -0.4), xlim=(-1, len(order) + 9))
    ax.set_xlabel("grasps that are feasible at one of the poses")
    ax.set_title(f"{plan.problem.object.name}: feasible grasps (dots), shared by neighbours (lines)")
    return figure


def save_strip(panels: list[Image.Image], captions: tuple[str, ...], name: str) -> None:
    """Write pictures side by side with a caption above each."""
    figure, axes = plt.subplots(1, len(panels), figsize=(4 * len(panels), 4.1), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.08)
    for ax, panel, caption in zip(axes, panels, captions, strict=True):
        ax.imshow(panel)
        ax.set_title(caption, fontsize=14)
        ax.axis("off")
    figure.savefig(IMAGES / name, dpi=100)


def photograph_candidates(browser: webdriver.Chrome, plan: RegraspPlan, trace: CandidateTrace, page: Path) -> None:
    """Write the candidates at the start, on their way and refined."""
    write_plan_page(plan, page, candidates=trace)
    browser.get(page.as_uri())
    browser.execute_script(HIDE_CARDS + "document.getElementById('marks').click(); plan.look(0.9)")
    frames = (0, 4, len(trace.cost) - 1)
    panels = []
    for frame in frames:
        browser.execute_script("iteration.value = arguments[0]; iteration.dispatchEvent(new Event('input'))", frame)
        panels.append(photograph(browser, 620, 520))
    save_strip(panels, tuple(trace.label(k).split(", ")[1].split(":")[0] for k in frames), "candidates.png")


def photograph_causes(browser: webdriver.Chrome, problem: RegraspProblem, page: Path) -> None:
    """Save a picture of the page of a plan that failed: a wall is in the way of the start."""
    wall = {"type": "box", "name": "wall", "size": [0.3, 0.02, 0.3], "position": [0.26, 0.30, 0.15]}
    blocked = problem.with_obstacles([wall])
    plan = solve_sequence(blocked, *(parse_pose(text, "pose", blocked) for text in BLOCKED))
    assert not plan.solved
    write_plan_page(plan, page)
    browser.get(page.as_uri())
    browser.execute_script("plan.look(0.85)")
    photograph(browser, 1280, 760).save(IMAGES / "causes.png", optimize=True)


def photograph_scenes(browser: webdriver.Chrome, page: Path) -> None:
    """Write a picture of the plan of each scene with several supports: every time the object is picked or put down."""
    for name, (thing, *ends) in json.loads((SCENES / "tasks.json").read_text("utf-8")).items():
        problem = RegraspProblem.load(thing, SCENES / f"{name}.toml")
        plan = solve_sequence(problem, *(parse_pose(text, "pose", problem) for text in ends))
        write_plan_page(plan, page)
        browser.get(page.as_uri())
        browser.execute_script(HIDE_CARDS + "document.getElementById('marks').click(); plan.look(1.05)")
        panels, captions = [], []
        for step, station in enumerate(plan.stations):
            browser.execute_script("plan.show(arguments[0])", max(0, 2 * step - 1))
            panels.append(photograph(browser, 520, 480))
            captions.append(f"{step + 1}. {station.support}")
        save_strip(panels, tuple(captions), f"{name}.png")


def draw_sweep(problem: RegraspProblem) -> Figure:
    """Return a picture of the costs while the intermediate pose moves from the goal to the start (Fig. 5)."""
    ends = [parse_pose(text, "pose", problem) for text in SWEPT]
    curves = tables.grouped(sweep(problem, Instance("sweep", *ends, None)), "grasps")
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained", sharex=True)
    for ax, (cost, name) in zip(axes, COST_NAMES.items(), strict=False):
        for ((count,), rows), style in zip(curves.items(), STYLES, strict=False):
            ax.plot([row["step"] for row in rows], [row[cost] for row in rows], label=f"{count} grasps", **style)
        ax.set(title=name, ylabel="cost")
    (most,), rows = max(curves.items())
    for key, style in zip(("shared_start", "shared_goal", "shared_all"), STYLES, strict=False):
        label = key.replace("shared_", "with ")
        axes[-1].plot([row["step"] for row in rows], [row[key] for row in rows], label=label, **style)
    axes[-1].set(title=f"shared grasps (exact), of {most}", ylabel="grasps")
    for ax in axes:
        ax.set_xlabel("step, from goal to start")
    for ax in (axes[0], axes[-1]):
        ax.legend(fontsize="small")
    figure.suptitle("Costs while the intermediate pose moves")
    return figure


def main() -> None:
    """Write pictures of a plan: its steps, the page, candidates by iteration, its grasps and its cost."""
    plan = solve()
    trace = trace_candidates(plan, Recipe(NlpRefiner(), starts="random", batches=(12,), verified=12))
    print(plan.status.name, np.round(plan.xi, 3).tolist())
    IMAGES.mkdir(exist_ok=True)
    draw_energy(plan.problem).savefig(IMAGES / "energy.png", dpi=100)
    draw_chain(plan).savefig(IMAGES / "chain.png", dpi=100)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        page = Path(folder) / "plan.html"
        write_plan_page(plan, page)
        browser = open_browser(f"{folder}/profile")
        try:
            browser.get(page.as_uri())
            browser.find_element(By.ID, "field").send_keys("of pose 1")
            browser.execute_script("plan.show(1)")
            photograph(browser, 1280, 760).save(IMAGES / "page.png", optimize=True)
            browser.find_element(By.ID, "field").send_keys("hidden")
            browser.find_element(By.ID, "marks").click()
            browser.execute_script(HIDE_CARDS + "plan.look(0.82)")
            panels = []
            for step in range(len(CAPTIONS)):
                browser.execute_script(f"plan.show({step})")
                panels.append(photograph(browser, 520, 480))
            photograph_candidates(browser, plan, trace, page)
            photograph_causes(browser, plan.problem, page)
            photograph_scenes(browser, page)
        finally:
            browser.quit()
    save_strip(panels, CAPTIONS, "plan.png")
    plot_cost_landscape(plan).savefig(IMAGES / "landscape.png", dpi=100)
    plot_pose_distribution(plan).savefig(IMAGES / "poses.png", dpi=100)
    plot_cost_traces(trace).savefig(IMAGES / "traces.png", dpi=100)
    draw_sweep(plan.problem).savefig(IMAGES / "sweep.png", dpi=100)


if __name__ == "__main__":
    main()
