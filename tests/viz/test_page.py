"""The page in a real browser: it draws, without a network and without complaint, and answers to slider and mouse."""

import json
import re

import numpy as np
import pytest

from regrasp_opt.viz import write_plan_page, write_problem_page


@pytest.fixture(scope="module")
def page(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "plan.html"
    write_plan_page(plan, path)
    return path


@pytest.fixture
def shown(page, browser, complaints):
    complaints()
    browser.get(page.as_uri())
    return browser


def element(browser, name):
    return browser.find_element("id", name)


def changed(first, second):
    """Return the share of pixels that differ."""
    return (np.abs(first - second).max(axis=-1) > 12).mean()


def test_the_page_refers_to_nothing_outside_of_it(page):
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r"https?://|//cdn|@import|fetch\(|XMLHttpRequest", text)
    assert re.findall(r'\b(?:src|href)="([^"]*)"', text) == ["data:,"]
    assert "{{" not in text
    assert len(text) < 3_000_000


def test_the_page_draws_without_a_network_and_without_errors(shown, picture, complaints, plan):
    assert shown.title == "bottle in nova2-w"
    assert f"J_seq {plan.cost:.2f}" in element(shown, "subtitle").text
    requested = shown.execute_script("return performance.getEntriesByType('resource').map((e) => e.name)")
    assert [url for url in requested if not url.startswith("data:")] == []
    image = picture()
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 500
    assert complaints() == []


def test_the_slider_moves_the_scene(shown, picture, complaints):
    from selenium.webdriver.common.keys import Keys

    before = picture()
    assert element(shown, "label").text == "move 0: pick"
    element(shown, "slider").send_keys(Keys.ARROW_RIGHT)
    assert element(shown, "label").text == "move 0: place"
    assert changed(before, picture()) > 0.02
    element(shown, "slider").send_keys(Keys.END)
    assert element(shown, "label").text == "move 1: place"
    assert shown.execute_script("return plan.step") == 3
    assert complaints() == []


def test_a_click_chooses_a_grasp(shown, picture, plan):
    from selenium.webdriver import ActionChains

    before, transition = picture(), plan.transitions[0]
    best = int(transition.clearance.argmax())
    spots = np.array([shown.execute_script("return plan.screen(arguments[0])", int(g)) for g in transition.grasp_ids])
    apart = np.linalg.norm(spots - spots[best], axis=1)
    wanted = int(apart.argmax())
    assert apart[wanted] > 3
    canvas = shown.find_element("tag name", "canvas")
    x, y = spots[wanted] - np.array([canvas.size["width"], canvas.size["height"]]) / 2
    ActionChains(shown).move_to_element_with_offset(canvas, round(x), round(y)).click().perform()
    info = element(shown, "info").text
    chosen = int(re.match(r"grasp (\d+),", info)[1])
    assert chosen != transition.grasp_ids[best]
    k = transition.grasp_ids.tolist().index(chosen)
    assert f"clearance {1e3 * transition.clearance[k]:.1f} mm" in info
    assert shown.execute_script("return plan.state") == 2 * k
    assert changed(before, picture()) > 0.001


def test_boxes_and_the_cost_over_the_table_change_the_picture(shown, picture, complaints):
    before = picture()
    element(shown, "ghosts").click()
    without = picture()
    assert changed(before, without) > 0.003
    element(shown, "field").send_keys("of pose 1")
    assert changed(without, picture()) > 0.03
    assert element(shown, "what").text == "connectivity cost J_seq (low: more shared grasps)"
    assert complaints() == []


def test_play_reaches_the_end(shown):
    from selenium.webdriver.support.ui import WebDriverWait

    element(shown, "play").click()
    WebDriverWait(shown, 60).until(lambda d: d.execute_script("return plan.step") == 3)
    WebDriverWait(shown, 60).until(lambda _: element(shown, "play").text == "Play")


def test_a_plan_that_was_not_found_has_a_page(bottle_problem, tmp_path, browser, picture, complaints):
    from regrasp_opt import solve_sequence

    ends = bottle_problem.pose(1, 0.26, 0.40, -0.5), bottle_problem.pose(0, -0.26, 0.40, 0.2)
    write_plan_page(solve_sequence(bottle_problem, *ends, max_regrasps=0), tmp_path / "none.html")
    complaints()
    browser.get((tmp_path / "none.html").as_uri())
    assert "no plan was found" in element(browser, "subtitle").text
    assert len(np.unique(picture().reshape(-1, 3), axis=0)) > 500
    assert complaints() == []


def test_an_object_and_a_workcell_have_a_page(bottle_problem, tmp_path, browser, picture, complaints):
    write_problem_page(bottle_problem.object, bottle_problem.workcell, tmp_path / "cell.html")
    complaints()
    browser.get((tmp_path / "cell.html").as_uri())
    assert element(browser, "label").text == "placement 0"
    assert len(np.unique(picture().reshape(-1, 3), axis=0)) > 500
    assert complaints() == []


def test_names_cannot_break_out_of_the_page(plan, tmp_path):
    from dataclasses import replace

    from regrasp_opt.viz.page import page_text
    from regrasp_opt.viz.scene import plan_scene

    text = page_text(replace(plan_scene(plan), title="</script><b>{{script}}"))
    assert "<b>" not in text
    body = re.search(r'<script id="scene" type="application/json">(.*?)</script>', text, re.S)[1]
    assert json.loads(body)["title"] == "</script><b>{{script}}"
