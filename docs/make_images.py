"""Make the pictures of the README and the first page: `python docs/make_images.py`.

It needs the extras ``viz`` and ``dev``, Chromium and its driver on the path. The pictures are of the page that
``regrasp-opt plan --html`` writes.
"""

from __future__ import annotations

import base64
import io
import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.by import By

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.pose_text import parse_pose
from regrasp_opt.viz import write_plan_page
from regrasp_opt.viz.plots import plot_cost_landscape, plot_pose_distribution

IMAGES = Path(__file__).parent / "images"
START, GOAL = "1:0.26,0.40,-30", "0:-0.26,0.40,10"
CAPTIONS = (
    "1. pick at the start",
    "2. put down at the intermediate pose",
    "3. pick with another grasp",
    "4. put down at the goal",
)


def solve() -> RegraspPlan:
    """Return the plan of the pictures: a bottle that lies on one side is to lie on the next."""
    problem = RegraspProblem.load("bottle", "nova2-w")
    ends = [parse_pose(text, "pose", problem.placement_poses) for text in (START, GOAL)]
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


def main() -> None:
    """Write pictures of a plan: its steps, the page, the cost over the table and over all lattice poses."""
    plan = solve()
    print(plan.status.name, np.round(plan.xi, 3).tolist())
    IMAGES.mkdir(exist_ok=True)
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
            hide = "for (const card of document.querySelectorAll('.card')) card.style.visibility = 'hidden';"
            browser.execute_script(hide + "plan.look(0.82)")
            panels = []
            for step in range(len(CAPTIONS)):
                browser.execute_script(f"plan.show({step})")
                panels.append(photograph(browser, 520, 480))
        finally:
            browser.quit()
    figure, axes = plt.subplots(1, len(panels), figsize=(16, 4.1), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.08)
    for ax, panel, caption in zip(axes, panels, CAPTIONS, strict=True):
        ax.imshow(panel)
        ax.set_title(caption, fontsize=14)
        ax.axis("off")
    figure.savefig(IMAGES / "plan.png", dpi=100)
    plot_cost_landscape(plan).savefig(IMAGES / "landscape.png", dpi=100)
    plot_pose_distribution(plan).savefig(IMAGES / "poses.png", dpi=100)


if __name__ == "__main__":
    main()
