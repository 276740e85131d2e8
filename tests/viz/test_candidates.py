"""The candidates of a refiner by iteration: what is traced, and that the page shows it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from regrasp_opt import Recipe, RegraspError, solve_sequence
from regrasp_opt.solvers import LangevinRefiner, Refinement
from regrasp_opt.viz import candidates, trace_candidates, write_plan_page


@dataclass(frozen=True)
class Idle:
    """A refiner that keeps nothing by iteration; with a `shift` [m] it leads out of the workspace."""

    name: str = "idle"
    shift: float = 0.0

    def refine(self, objective, starts, rng):
        moved = replace(starts, xi=starts.xi + self.shift)
        return Refinement(moved, ("kept",) * len(starts), tuple(starts.cost[:, None]))


def test_the_plan_comes_from_the_accepted_candidate(plan):
    ours = solve_sequence(plan.problem, plan.poses[0], plan.poses[-1], seed=plan.seed)
    trace = trace_candidates(ours, "ipopt")
    np.testing.assert_array_equal(trace.xi[-1, trace.accepted], ours.xi)
    np.testing.assert_allclose(trace.poses[-1, trace.accepted], ours.poses[1:-1], atol=1e-12)
    assert trace.cost[-1, trace.accepted] == pytest.approx(ours.cost, abs=1e-9)


def test_frames_go_from_start_points_to_refined_poses(trace, plan):
    frames, count, length = trace.xi.shape[:3]
    assert count in (4, candidates.SHOWN) and length == 1 and frames > 3
    assert (trace.cost[-1] <= trace.cost[0] + 1e-9).all()
    assert trace.cost[-1].min() < trace.cost[0].min() - 0.1
    assert (np.diff(np.delete(trace.cost[-1], trace.accepted)) >= 0).all()
    assert np.abs(trace.xi[1] - trace.xi[0]).max() > 1e-3
    turned = (trace.xi[-1, ..., 2] - trace.xi[-2, ..., 2]) / (2 * np.pi)
    assert np.abs(turned).max() <= 0.5
    assert trace.label(0).startswith("ipopt, start points: J_seq ")
    assert trace.label(1).startswith(f"ipopt, iteration 1 of {frames - 2}: ")
    assert trace.label(frames - 1).startswith("ipopt, refined: ")


def test_langevin_has_a_frame_for_each_step(plan):
    refiner = LangevinRefiner(iterations=6, device="cpu")
    trace = trace_candidates(plan, Recipe(refiner, starts="random", batches=(30,), verified=30))
    assert trace.xi.shape[:2] == (8, candidates.SHOWN)
    assert trace.refiner == "langevin"


def test_a_refiner_that_keeps_nothing_shows_start_and_end(plan):
    trace = trace_candidates(plan, Recipe(Idle(), batches=(3,), verified=3))
    assert trace.xi.shape[:2] == (2, 3)
    np.testing.assert_array_equal(trace.xi[0], trace.xi[1])
    assert trace.accepted is not None


def test_candidates_that_did_not_become_the_plan_are_shown_too(plan):
    unsolved = solve_sequence(plan.problem, plan.poses[0], plan.poses[-1], max_regrasps=0)
    trace = trace_candidates(unsolved, Recipe(Idle(shift=2.0), batches=(2,), fallback=0))
    assert trace.xi.shape[:2] == (2, 2) and trace.accepted is None


def test_trails_follow_the_candidates(trace):
    surface, cost = candidates.trail(trace)
    frames, count, length = trace.xi.shape[:3]
    assert len(surface.faces) == 2 * (frames - 1) * count * length and len(cost) == len(surface.vertices)
    quads = surface.vertices.reshape(frames - 1, count * length, 4, 3)
    np.testing.assert_allclose(quads[:, :, :2].mean(axis=2)[..., :2], trace.xi[:-1, :, 0, :2], atol=1e-12)
    np.testing.assert_allclose(quads[:, :, 2:].mean(axis=2)[..., :2], trace.xi[1:, :, 0, :2], atol=1e-12)
    assert (surface.vertices[:, 2] == candidates.LIFT).all()
    first = surface.faces[: 2 * count * length]
    assert first.max() < 4 * count * length
    np.testing.assert_array_equal(cost.reshape(frames - 1, -1, 4)[0, :, 0], trace.cost[0])


def test_nothing_is_refined_where_one_grasp_does(plan):
    direct = solve_sequence(plan.problem, plan.poses[0], plan.poses[0])
    assert direct.solved and direct.num_regrasps == 0
    with pytest.raises(RegraspError, match="start and goal share a grasp, so nothing was refined"):
        trace_candidates(direct)


@pytest.fixture(scope="module")
def page(plan, trace, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "candidates.html"
    write_plan_page(plan, path, candidates=trace)
    return path


def test_the_page_steps_through_the_iterations(page, trace, browser, picture, complaints):
    from selenium.webdriver.common.keys import Keys

    complaints()
    browser.get(page.as_uri())
    stage, slider = (browser.find_element("id", name) for name in ("stage", "iteration"))
    assert stage.text == trace.label(0)
    start = picture()
    slider.send_keys(Keys.END)
    assert stage.text == trace.label(len(trace.xi) - 1)
    end = picture()
    assert (np.abs(end - start).max(axis=-1) > 12).mean() > 0.005
    browser.find_element("id", "candidates").click()
    assert (np.abs(picture() - end).max(axis=-1) > 12).mean() > 0.005
    assert complaints() == []
