"""Plots show what they say, with units, and tell what to install."""

import sys

import numpy as np
import pytest

from regrasp_opt import RegraspError
from regrasp_opt.viz import fields, plots


@pytest.fixture
def figures(monkeypatch):
    """Let matplotlib draw without a screen, and close what it drew."""
    matplotlib = pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    matplotlib.use("agg")
    yield
    matplotlib.pyplot.close("all")


def panels(figure):
    return [ax for ax in figure.axes if ax.get_title()]


def test_the_landscape_shows_the_cost_at_each_turn(plan, figures):
    figure = plots.plot_cost_landscape(plan, turns=2)
    here, turned = panels(figure)
    assert [here.get_title(), turned.get_title()] == ["turned by 0°", "turned by 180°"]
    for ax, angle in ((here, 0.0), (turned, np.pi)):
        np.testing.assert_allclose(ax.collections[0].get_array(), fields.cost_field(plan, 1, angle).cost)
    assert here.get_xlabel() == "x [m]" and here.get_ylabel() == "y [m]"
    lines = {line.get_label(): np.ravel(line.get_xydata()) for line in here.lines}
    np.testing.assert_allclose(lines["plan"], plan.xi[0, :2])
    np.testing.assert_allclose(lines["start"], [0.26, 0.40], atol=1e-9)
    assert "bottle" in figure.get_suptitle()


def test_the_distribution_has_the_best_angle_of_each_place(plan, figures):
    lattice = plan.problem.lattice
    figure = plots.plot_pose_distribution(plan)
    shown = panels(figure)
    assert len(shown) == len(plan.problem.placements)
    arrows = [ax.collections[0] for ax in shown]
    assert sum(len(a.get_offsets()) for a in arrows) * plots.YAWS == len(lattice.xi)
    costs = [a.get_array().min() for a in arrows]
    assert int(np.argmin(costs)) == plan.placements[0]
    assert min(costs) == pytest.approx(plan.cost, abs=1e-3)
    for ax, cost in zip(shown, costs, strict=True):
        assert ax.get_title().endswith(f"best {cost:.1f}")


def test_there_is_no_landscape_of_a_pose_that_is_not_there(plan, figures):
    with pytest.raises(RegraspError, match="no intermediate pose 2; the plan has 1"):
        plots.plot_cost_landscape(plan, 2)


def test_without_matplotlib_one_sentence_says_what_to_install(plan, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(RegraspError, match=r"regrasp-opt\[viz\]"):
        plots.plot_pose_distribution(plan)


def test_cost_traces_end_in_the_plan(trace, figures):
    figure = plots.plot_cost_traces(trace)
    [ax] = figure.axes
    lines = [np.asarray(line.get_ydata()) for line in ax.lines if len(np.atleast_1d(line.get_ydata())) > 1]
    np.testing.assert_allclose(lines, trace.cost.T)
    star = next(line for line in ax.lines if line.get_label() == "the plan")
    assert star.get_xydata()[0] == pytest.approx([len(trace.cost) - 1, trace.cost[-1, trace.accepted]])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("iteration", "J_seq") and "ipopt" in ax.get_title()
