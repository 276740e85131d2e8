"""Grasps are coloured by why they fail, and the legend on the page names every colour."""

from collections import Counter

import numpy as np
import pytest

from regrasp_opt import solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.feasibility.diagnosis import Cause, diagnose
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.viz import scene, write_plan_page
from regrasp_opt.viz.causes import CAUSE_COLOURS, FEASIBLE, grasp_causes


@pytest.fixture(scope="module")
def blocked(bottle_problem):
    """Return a plan that fails as a lid is over the start."""
    lid = Box("lid", np.array([0.3, 0.3, 0.01]), translation(0.25, 0.35, 0.14))
    problem = bottle_problem.with_obstacles([lid])
    plan = solve_sequence(problem, problem.pose(0, 0.25, 0.35, 0.5), problem.pose(1, -0.28, 0.38, 2.1), "exact")
    assert plan.status.name == "START_INFEASIBLE"
    return plan


def test_every_grasp_has_the_colour_of_its_cause(blocked):
    for T, told in zip(blocked.poses, grasp_causes(blocked), strict=True):
        failures = diagnose(blocked.problem.checker, T)
        colours = [told.legend[k][1] for k in told.of_grasp]
        assert colours == [FEASIBLE if f is None else CAUSE_COLOURS[f.cause] for f in failures]
        counts = Counter(told.of_grasp.tolist())
        assert [count for *_, count in told.legend] == [counts[k] for k in range(len(told.legend))]
    assert any(text == "gripper in obstacle 'lid'" for text, *_ in grasp_causes(blocked)[0].legend)


def test_causes_of_grasps_have_colours_that_differ():
    of_tasks = {Cause.REFUSED, Cause.TOO_WIDE, Cause.NOT_SHARED}
    assert set(CAUSE_COLOURS) == set(Cause) - of_tasks
    assert len({*CAUSE_COLOURS.values(), FEASIBLE}) == len(CAUSE_COLOURS) + 1


def test_each_step_is_at_a_pose_of_the_plan(blocked, plan):
    assert [(step.label, step.pose) for step in scene.plan_scene(blocked).steps] == [("start", 0), ("goal", 1)]
    drawn = scene.plan_scene(plan)
    for step in drawn.steps:
        np.testing.assert_allclose(drawn.states[step.state, -1, :3], plan.poses[step.pose, :3, 3], atol=1e-6)


def test_the_page_names_the_colours(blocked, tmp_path, browser, picture, complaints):
    write_plan_page(blocked, tmp_path / "blocked.html")
    complaints()
    browser.get((tmp_path / "blocked.html").as_uri())
    shown = browser.find_element("id", "causekeys")
    for step, told in enumerate(grasp_causes(blocked)):
        browser.execute_script("plan.show(arguments[0])", step)
        assert shown.text.splitlines() == [f"{count} {text}" for text, _, count in told.legend if count]
    with_marks = picture()
    assert not browser.find_element("id", "markline").is_displayed()
    browser.find_element("id", "causes").click()
    assert shown.text == "" and (np.abs(with_marks - picture()).max(axis=-1) > 12).mean() > 0.001
    assert complaints() == []


def test_a_plan_shows_shared_grasps_until_asked_for_causes(plan, tmp_path, browser, picture, complaints):
    from selenium.webdriver import ActionChains

    write_plan_page(plan, tmp_path / "plan.html")
    browser.get((tmp_path / "plan.html").as_uri())
    assert browser.find_element("id", "causekeys").text == ""
    before = picture()
    browser.find_element("id", "causes").click()
    assert "feasible" in browser.find_element("id", "causekeys").text
    assert (np.abs(before - picture()).max(axis=-1) > 12).mean() > 0.001
    browser.execute_script("plan.show(3)")  # the goal, beside the panel
    spots = [browser.execute_script("return plan.screen(arguments[0])", k) for k in range(len(plan.problem.grasps))]
    canvas = browser.find_element("tag name", "canvas")
    away = np.array(spots) - np.array([canvas.size["width"], canvas.size["height"]]) / 2
    x, y = away[np.linalg.norm(away, axis=1).argmin()]
    ActionChains(browser).move_to_element_with_offset(canvas, round(x), round(y)).click().perform()
    texts = [text for text, *_ in grasp_causes(plan)[-1].legend]
    said = browser.find_element("id", "info").text
    assert said.startswith("grasp ") and said.split(": ", 1)[1] in texts
    assert complaints() == []
