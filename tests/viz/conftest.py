"""A plan with one regrasp, and a headless Chromium without a network."""

import io
import shutil

import numpy as np
import pytest

OPTIONS = (
    *("--headless=new", "--no-sandbox", "--no-first-run", "--hide-scrollbars", "--window-size=900,700"),
    *("--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-quic", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)


@pytest.fixture(scope="session")
def plan(bottle_problem):
    """Return the plan of a bottle that lies on one side and is to lie on the next."""
    from regrasp_opt import solve_sequence

    start, goal = bottle_problem.pose(1, 0.26, 0.40, -0.5), bottle_problem.pose(0, -0.26, 0.40, 0.2)
    found = solve_sequence(bottle_problem, start, goal, refiner="lattice")
    assert found.solved and found.num_regrasps == 1
    return found


@pytest.fixture(scope="session")
def trace(plan):
    """Return how Ipopt refines random candidates for the plan."""
    from regrasp_opt import Recipe
    from regrasp_opt.solvers import NlpRefiner
    from regrasp_opt.viz import trace_candidates

    return trace_candidates(plan, Recipe(NlpRefiner(), starts="random", batches=(4, 10), verified=14))


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """Return a Selenium driver of a Chromium that reaches nothing but this machine."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    programs = {name: shutil.which(name) for name in ("chromium", "chromedriver")}
    missing = [name for name, path in programs.items() if path is None]
    if missing:
        pytest.skip(f"no {' and no '.join(missing)} on the path (Debian: chromium, chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = programs["chromium"]
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(programs["chromedriver"]))
    driver.set_page_load_timeout(120)
    driver.set_script_timeout(120)
    yield driver
    driver.quit()


@pytest.fixture
def picture(browser):
    """Return a function that waits for the next frames and returns the picture (H, W, 3) of the canvas."""
    from PIL import Image
    from selenium.webdriver.common.by import By

    def take():
        browser.execute_async_script(
            "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()));"
        )
        image = browser.find_element(By.TAG_NAME, "canvas").screenshot_as_png
        return np.asarray(Image.open(io.BytesIO(image)).convert("RGB")).astype(int)

    return take


@pytest.fixture
def complaints(browser):
    """Return a function that returns what the console called an error since the last call."""

    def since():
        return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]

    return since
