"""`RegraspProblem.nlp`: the program of one problem, from poses."""

import numpy as np
import pytest

from regrasp_opt import solve_sequence
from regrasp_opt.errors import OptionError, PoseError

START, GOAL = (0, -0.25, 0.40, 0.5), (1, 0.28, 0.38, 2.1)


@pytest.fixture(scope="module")
def ends(bottle_problem):
    return bottle_problem.pose(*START), bottle_problem.pose(*GOAL)


@pytest.fixture(scope="module")
def plan(bottle_problem, ends):
    return solve_sequence(bottle_problem, *ends)


def test_it_finds_what_the_planner_finds_and_grasps_remain(bottle_problem, ends, plan):
    nlp = bottle_problem.nlp(*ends, placements=plan.placements, guess=plan.xi)
    assert float(nlp.functions.J_seq(plan.xi)) == pytest.approx(plan.cost, abs=1e-9)
    solution = nlp.solve()
    assert solution.converged and solution.f <= plan.cost + 1e-9
    found = bottle_problem.pose(plan.placements[0], *nlp.unpack(solution.x)["xi"][0])
    feasible = np.array([bottle_problem.feasible_grasps(T) for T in (ends[0], found, ends[1])])
    assert (feasible[:-1] & feasible[1:]).any(axis=1).all()


def test_placements_and_guess_come_from_the_lattice(bottle_problem, ends):
    nlp = bottle_problem.nlp(*ends, num_regrasps=2)
    assert nlp.xi.shape == (2, 3)
    assert nlp.solve().f < float(nlp.functions.J_seq(nlp.arguments["x0"].reshape(2, 3)))
    fixed = bottle_problem.nlp(*ends, placements=[0])
    low, high = bottle_problem.workcell.bounds.array
    assert (fixed.arguments["x0"][:2] >= low).all() and (fixed.arguments["x0"][:2] <= high).all()


def test_an_end_may_be_a_parameter_or_energies(bottle_problem, ends, plan):
    arguments = {"placements": plan.placements, "guess": plan.xi}
    whole = bottle_problem.nlp(*ends, **arguments, mask=np.ones(len(bottle_problem.grasps), dtype=bool)).solve().f
    known = bottle_problem.nlp(*ends, **arguments, mask="input")
    assert known.blocks["p"] == {"mask": slice(0, len(bottle_problem.grasps))}
    assert known.solve().f == pytest.approx(whole, abs=1e-9)
    energies = np.where(bottle_problem.feasible_grasps(ends[0]), 0.0, 30.0)
    given = bottle_problem.nlp("input", ends[1], **arguments)
    given.set_parameter("start", energies)
    assert given.solve().f == pytest.approx(whole, abs=1e-9)
    assert bottle_problem.nlp(energies, ends[1], **arguments).solve().f == pytest.approx(whole, abs=1e-6)


def test_without_a_guess_poses_start_at_the_centre_of_the_workspace(bottle_problem, ends):
    nlp = bottle_problem.nlp("input", ends[1], placements=[0, 3])
    nlp.set_parameter("start", np.zeros(len(bottle_problem.grasps)))
    center = bottle_problem.workcell.bounds.array.mean(axis=0)
    np.testing.assert_allclose(nlp.arguments["x0"], [*center, 0.0, *center, 0.0])


def test_ends_that_cannot_be_are_refused(bottle_problem, ends, monkeypatch):
    floating = ends[0].copy()
    floating[2, 3] += 0.1
    with pytest.raises(PoseError, match="start pose"):
        bottle_problem.nlp(floating, ends[1])
    with pytest.raises(OptionError, match="give placements"):
        bottle_problem.nlp("input", ends[1])
    nothing = np.zeros(len(bottle_problem.grasps), dtype=bool)
    monkeypatch.setattr(type(bottle_problem), "feasible_grasps", lambda self, T: nothing)
    with pytest.raises(PoseError, match="no grasp is feasible at the start pose"):
        bottle_problem.nlp(*ends)


@pytest.mark.parametrize("count", [0, -1, 1.5, True, None, "2"])
def test_the_number_of_poses_is_a_whole_one(bottle_problem, ends, count):
    with pytest.raises(OptionError, match=f"the program has {count} intermediate poses; give at least 1"):
        bottle_problem.nlp(*ends, num_regrasps=count)
