"""The live viewer in a real browser."""

import numpy as np
import pytest

from regrasp_opt.viz.scene import plan_scene


def test_the_viewer_draws_and_its_slider_moves_the_scene(plan, trace, browser, picture, complaints, capsys):
    pytest.importorskip("viser", reason="viser is not installed")
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait

    from regrasp_opt.viz.viewer import PlanViewer

    viewer = PlanViewer(plan_scene(plan, candidates=trace), port=18432, shadows=False)
    try:
        complaints()
        browser.get(viewer.url)
        wait = WebDriverWait(browser, 120)
        wait.until(lambda d: "move 0: pick" in d.page_source)
        wait.until(lambda _: len(np.unique(picture().reshape(-1, 3), axis=0)) > 500)
        thumb = browser.find_element("css selector", "[role=slider]")
        thumb.send_keys(Keys.ARROW_RIGHT)
        wait.until(lambda _: viewer.step == 1)
        wait.until(lambda d: "move 0: place" in d.page_source)
        before = picture()
        viewer.show(3)
        wait.until(lambda _: (np.abs(picture() - before).max(axis=-1) > 12).mean() > 0.002)
        viewer.candidates.show(len(trace.xi) - 1)
        wait.until(lambda d: trace.label(len(trace.xi) - 1) in d.page_source)
        first = int(plan.transitions[0].clearance.argmax())
        viewer.show(0)
        viewer.choose(0, (first + 1) % len(plan.transitions[0].grasp_ids))
        chosen = plan.transitions[0].grasp_ids[(first + 1) % len(plan.transitions[0].grasp_ids)]
        wait.until(lambda d: f"grasp {chosen}, one of" in d.page_source)
        assert complaints() == []
    finally:
        viewer.stop()
    assert capsys.readouterr().out == ""


def test_without_viser_one_sentence_says_what_to_do(plan, monkeypatch):
    import sys

    from regrasp_opt import RegraspError
    from regrasp_opt.viz.viewer import PlanViewer

    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(RegraspError, match=r"regrasp-opt\[viz\].*--html FILE"):
        PlanViewer(plan_scene(plan))
