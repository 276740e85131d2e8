"""`solve_many`: the results of `solve_sequence` in order, from processes, refusals among them; pickled problems."""

import pickle

import numpy as np
import pytest

from regrasp_opt import RegraspError, RegraspPlan, RegraspProblem, solve_many, solve_sequence
from regrasp_opt.errors import OptionError, PoseError
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="module")
def pairs(bottle_problem):
    rng = np.random.default_rng(5)
    return [random_task(bottle_problem, rng)[:2] for _ in range(5)]


def same(a, b):
    """Return whether two plans have the same content."""
    transitions = zip(a.transitions, b.transitions, strict=True)
    arrays = [(a.poses, b.poses), (a.xi, b.xi), *((x.q_pick, y.q_pick) for x, y in transitions)]
    return a.status is b.status and all(np.array_equal(*pair) for pair in arrays)


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_are_those_of_single_plans_in_order(bottle_problem, pairs, jobs):
    floating = pairs[0][0].copy()
    floating[2, 3] += 0.2
    tasks, told = [*pairs[:3], (floating, pairs[0][1]), *pairs[3:]], []
    found = solve_many(bottle_problem, tasks, "lattice", jobs=jobs, progress=lambda *n: told.append(n), seed=7)
    assert isinstance(found[3], PoseError) and "above the table" in str(found[3])
    plans = [plan for plan in found if isinstance(plan, RegraspPlan)]
    assert len(plans) == 5 and told[-1] == (6, 6) and told == sorted(told)
    for plan, pair in zip(plans, pairs, strict=True):
        assert plan.problem is bottle_problem
        assert same(plan, solve_sequence(bottle_problem, *pair, "lattice", seed=7))


def test_no_pairs_give_no_plans(bottle_problem):
    assert solve_many(bottle_problem, []) == []


def test_options_are_checked(bottle_problem, pairs):
    with pytest.raises(OptionError, match="pair 1 has 3 parts; give a start and a goal pose"):
        solve_many(bottle_problem, [pairs[0], (*pairs[0], 1)])
    with pytest.raises(OptionError, match="jobs is 0"):
        solve_many(bottle_problem, pairs, jobs=0)
    (refused,) = solve_many(bottle_problem, pairs[:1], "none", jobs=1)
    assert isinstance(refused, RegraspError) and "unknown refiner" in str(refused)


def test_problems_and_plans_are_pickled_before_and_after_use(pairs):
    problem = RegraspProblem.load("bottle", "nova2-w")
    fresh = pickle.loads(pickle.dumps(problem))
    plan = solve_sequence(problem, *pairs[0])
    used = pickle.loads(pickle.dumps(problem))
    assert len(pickle.dumps(problem)) < 2e6
    for copy in (fresh, used):
        assert same(solve_sequence(copy, *pairs[0]), plan)
    copied = pickle.loads(pickle.dumps(plan))
    assert same(copied, plan) and copied.residuals().hold
