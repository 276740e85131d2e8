"""The page can be read: every colour has a name, stations are on the slider, labels hide no grasp, phones suffice."""

from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt.motion import plan_motion
from regrasp_opt.viz import track_of, write_plan_page
from regrasp_opt.viz.looks import COLOURS
from regrasp_opt.viz.page import _content
from regrasp_opt.viz.scene import plan_scene


@pytest.fixture(scope="module")
def page(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "plan.html"
    write_plan_page(plan, path)
    return path


@pytest.fixture
def phone(page, browser):
    """Return the browser as a phone that shows the page."""
    size = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(page.as_uri())
    yield browser
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def box(browser, css):
    script = """return [...document.querySelectorAll(arguments[0])].filter((e) => !e.hidden)
        .map((e) => { const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; })"""
    return np.array(browser.execute_script(script, css)).reshape(-1, 4)


def crossing(a, b):
    """Return whether boxes (N, 4) and (M, 4) overlap: (N, M)."""
    a, b = a[:, None], b[None]
    return ((a[..., :2] < b[..., 2:]) & (b[..., :2] < a[..., 2:])).all(axis=-1)


def test_the_legend_names_every_colour(plan, trace, browser, tmp_path):
    wall = {"type": "box", "name": "wall", "size": [0.1, 0.02, 0.1], "position": [0.0, 0.60, 0.05]}
    walled = replace(plan, problem=plan.problem.with_obstacles([wall]))
    content = _content(plan_scene(walled, candidates=trace))
    named = {colour for line in content["legend"] for colour in line["colours"]}
    assert {part["colour"] for part in content["parts"]} | {g["colour"] for g in content["ghosts"]} <= named
    assert content["chosen"] == COLOURS["chosen"] in named
    assert {part["name"] for part in content["parts"] if part["colour"] == COLOURS["obstacle"]} == {"wall"}
    write_plan_page(walled, tmp_path / "walled.html")
    browser.get((tmp_path / "walled.html").as_uri())
    shown = browser.find_element("id", "keys").text
    for name in ("start", "pose 1", "goal", "object", "arm", "gripper", "support: table", "obstacle: wall"):
        assert name in shown
    assert "grasp in use" in shown


def test_stops_are_where_the_object_rests(plan):
    motion = plan_motion(plan)
    for scene in (plan_scene(plan), plan_scene(plan, track_of(plan, motion.segments))):
        assert [stop.name for stop in scene.stops] == ["start", "pose 1", "goal"]
        assert [stop.support for stop in scene.stops] == ["table"] * 3
        at = scene.states[[step.state for step in scene.steps], -1, :3]
        for number, stop in enumerate(scene.stops):
            near = np.linalg.norm(at - plan.poses[number, :3, 3], axis=1) < 1e-6
            assert near[stop.first : stop.last + 1].all()
            assert not np.delete(near, range(stop.first, stop.last + 1)).sum() > 1  # lifted, it leaves after a moment


def test_a_click_on_a_stop_goes_there(page, browser):
    browser.get(page.as_uri())
    labels = browser.find_elements("css selector", "#stops button")
    assert [label.text.split("\n") for label in labels] == [[name, "table"] for name in ("start", "pose 1", "goal")]
    labels[1].click()
    assert browser.execute_script("return plan.step") == 1
    assert browser.find_element("id", "label").text == "move 0: place"


@pytest.mark.parametrize("causes", [False, True])
def test_labels_hide_no_grasp_no_panel_and_no_label(page, browser, picture, plan, causes):
    browser.get(page.as_uri())
    if causes:
        browser.find_element("id", "causes").click()
    labelled = 0
    for step in range(4):
        grasps = list(range(len(plan.problem.grasps))) if causes else plan.transitions[step // 2].grasp_ids.tolist()
        for turn in (0.0, 1.0, 2.5, 4.0):
            browser.execute_script("plan.show(arguments[0]); plan.camera.turn = arguments[1]; plan.look(1)", step, turn)
            picture()
            tags = box(browser, ".tag")
            palms = np.array(browser.execute_script("return arguments[0].map(plan.screen)", grasps))
            assert not crossing(tags, np.hstack([palms - 1, palms + 1])).any()
            assert not crossing(tags, box(browser, ".card")).any()
            assert crossing(tags, tags).sum() == len(tags)
            labelled += len(tags)
    assert labelled > 24


def test_nothing_is_cut_off_on_a_phone(phone, picture):
    picture()
    width, height = phone.execute_script("return [innerWidth, innerHeight]")
    assert (width, height) == (390, 844)
    for opened in (False, True):
        if opened:
            phone.find_element("css selector", "summary").click()
            picture()
        inside = box(phone, ".card, #slider, #play, #label, #stops button, #head .key")
        inside = inside[(inside[:, 2:] > inside[:, :2]).all(axis=1)]
        assert len(inside) >= 7
        assert (inside[:, 0] >= 0).all() and (inside[:, 2] <= width).all()
        head, bar = (box(phone, name)[0] for name in ("#head", "#bar"))
        assert head[1] >= 0 and bar[3] <= height and head[3] <= bar[1]
    points = [phone.execute_script("return plan.ghost(arguments[0])", k) for k in range(3)]
    assert all(0 <= x <= width and 0 <= y <= height for x, y in points)


def touch(browser, kind, *points):
    at = [{"x": float(x), "y": float(y), "id": k} for k, (x, y) in enumerate(points)]
    browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})


def test_fingers_turn_zoom_and_choose(phone, picture, plan):
    picture()
    look = "return [plan.camera.turn, plan.camera.distance, ...plan.camera.target]"
    before = phone.execute_script(look)
    touch(phone, "touchStart", (200, 620))
    touch(phone, "touchMove", (150, 620))
    touch(phone, "touchMove", (100, 620))
    touch(phone, "touchEnd")
    turned = phone.execute_script(look)
    assert turned[0] == pytest.approx(before[0] + 0.6) and turned[1:] == before[1:]
    touch(phone, "touchStart", (180, 600), (220, 600))
    touch(phone, "touchMove", (140, 600), (260, 600))
    touch(phone, "touchEnd")
    zoomed = phone.execute_script(look)
    assert zoomed[0] == turned[0] and zoomed[1] == pytest.approx(turned[1] / 3, rel=0.02)
    assert zoomed[2:] == pytest.approx(turned[2:], abs=0.02)
    touch(phone, "touchStart", (180, 600), (220, 600))
    touch(phone, "touchMove", (180, 540), (220, 540))
    touch(phone, "touchEnd")
    shifted = phone.execute_script(look)
    assert shifted[:2] == pytest.approx(zoomed[:2])
    assert np.linalg.norm(np.subtract(shifted[2:], zoomed[2:])) > 0.03

    phone.get(phone.current_url)
    picture()
    ids = plan.transitions[0].grasp_ids
    spots = np.array(phone.execute_script("return arguments[0].map(plan.screen)", ids.tolist()))
    best = int(plan.transitions[0].clearance.argmax())
    x, y = spots[np.linalg.norm(spots - spots[best], axis=1).argmax()]
    touch(phone, "touchStart", (x, y))
    touch(phone, "touchMove", (x + 3, y + 3))
    touch(phone, "touchEnd")
    assert not phone.find_element("id", "info").text.startswith(f"grasp {ids[best]},")
