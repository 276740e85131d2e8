"""A notebook shows plans and motions as their page: inline, in a frame that reaches nothing of the notebook."""

import html
import re
import subprocess
import sys

import pytest

from regrasp_opt.motion import plan_motion
from regrasp_opt.motion.motion_data import MotionStatus
from regrasp_opt.viz import track_of
from regrasp_opt.viz.page import page_text
from regrasp_opt.viz.scene import plan_scene


def page_in(shown):
    """Return the page in what a notebook shows."""
    frame = re.fullmatch(r'<iframe srcdoc="([^"]*)" sandbox="allow-scripts" (.*)></iframe>', shown._repr_html_())
    assert 'height="600"' in frame[2] and "<" not in frame[1]
    return html.unescape(frame[1])


@pytest.fixture(scope="module")
def motion(plan):
    found = plan_motion(plan)
    assert found.solved
    return found


def test_a_plan_is_shown_as_its_page(plan):
    assert page_in(plan) == page_text(plan_scene(plan))


def test_a_motion_is_shown_as_its_page(plan, motion):
    assert page_in(motion) == page_text(plan_scene(plan, track_of(plan, motion.segments)))


def test_without_a_motion_its_plan_is_shown(plan, motion):
    from dataclasses import replace

    assert page_in(replace(motion, status=MotionStatus.NO_MOTION, segments=())) == page_in(plan)


def test_the_page_draws_inside_another_page(plan, tmp_path, browser, picture, complaints):
    path = tmp_path / "notebook.html"
    path.write_text(f"<!doctype html><meta charset='utf-8'><p>In [1]</p>{plan._repr_html_()}", encoding="utf-8")
    complaints()
    browser.get(path.as_uri())
    assert browser.find_element("tag name", "iframe").size["height"] == 600
    browser.switch_to.frame(0)
    try:
        assert browser.find_element("id", "title").text == "bottle in nova2-w"
        assert len({tuple(row) for row in picture().reshape(-1, 3)}) > 500
    finally:
        browser.switch_to.default_content()
    assert complaints() == []


def test_a_user_of_the_public_names_alone_gets_the_page():
    script = """
import sys
from regrasp_opt import RegraspProblem, solve_sequence
problem = RegraspProblem.load("bottle", "nova2-w")
pose = problem.pose(0, 0.25, 0.35)
plan = solve_sequence(problem, pose, pose, "exact", max_regrasps=0)
assert "regrasp_opt.viz" not in sys.modules
assert plan._repr_html_().startswith("<iframe srcdoc=")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
