"""`solve_sequence`: what it returns, every way it can end, refiners, repetition, and the cost it reports."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from regrasp_opt import CostOptions, Recipe, RegraspPlan, RegraspProblem, Status, solve_sequence
from regrasp_opt.conventions import planar_transform
from regrasp_opt.errors import OptionError, UnknownNameError
from regrasp_opt.planning.recipes import as_recipe
from regrasp_opt.planning.tasks import random_graspable_pose, random_task
from regrasp_opt.solvers import Candidates, LangevinRefiner, LatticeRefiner


@pytest.fixture(scope="module")
def direct(bottle_problem):
    """Return a task whose ends share a grasp."""
    return random_task(bottle_problem, np.random.default_rng(3), needs_regrasp=False)


@pytest.fixture(scope="module")
def few_grasps(bottle_problem):
    """Return the bottle problem with five grasps, a pose at which one is feasible and a pose at which none is."""
    problem = RegraspProblem.load("bottle", "nova2-w", grasps=bottle_problem.grasps.subset(range(5)))
    rng, found = np.random.default_rng(1), {}
    while len(found) < 2:
        T = random_graspable_pose(bottle_problem, rng)
        found.setdefault(bool(problem.feasible_grasps(T).any()), T)
    return problem, found[True], found[False]


def numpy_cost(plan, alpha=1.0, lambda_reg=0.5):
    """Return Eq. 5 with exact knowledge at both ends and of what the table rules out, written out."""
    problem = plan.problem
    ruled_out = problem.table_rule(plan.placements, plan.xi)
    ends = [np.where(problem.feasible_grasps(T), 0.0, 30.0) for T in plan.poses[[0, -1]]]
    E = [ends[0], *np.where(ruled_out, 30.0, problem.energy(plan.poses[1:-1])), ends[1]]
    Q = np.array([-alpha * logsumexp(-(a + b) / alpha) for a, b in itertools.pairwise(E)])
    return Q.sum() + lambda_reg * (np.diff(Q) ** 2).sum()


def assert_contract(plan, problem, task):
    """Assert every type and shape that the contract states, and that the plan can be verified."""
    count, dof = plan.num_regrasps, problem.workcell.robot.dof
    assert isinstance(plan, RegraspPlan) and plan.status is Status.SOLVED and plan.solved
    assert plan.poses.shape == (count + 2, 4, 4) and plan.poses.dtype == np.float64
    np.testing.assert_allclose(plan.poses[[0, -1]], [task.start, task.goal], atol=1e-12)
    assert plan.placements.shape == (count,) and plan.xi.shape == (count, 3)
    for T, number, xi in zip(plan.poses[1:-1], plan.placements, plan.xi, strict=True):
        np.testing.assert_allclose(planar_transform(xi) @ problem.placements[number].pose, T, atol=1e-12)
    assert len(plan.transitions) == count + 1
    for i, transition in enumerate(plan.transitions):
        shared = np.logical_and(*(problem.feasible_grasps(T) for T in plan.poses[i : i + 2]))
        np.testing.assert_array_equal(transition.grasp_ids, np.flatnonzero(shared))
        assert transition.grasp_ids.dtype.kind == "i" and len(transition.grasp_ids) > 0
        assert transition.q_pick.shape == transition.q_place.shape == (len(transition.grasp_ids), dof)
        assert transition.clearance.shape == transition.grasp_ids.shape
        assert (transition.clearance > 0).all()
    assert isinstance(plan.cost, float) and np.isfinite(plan.cost)
    assert all(isinstance(seconds, float) and seconds >= 0 for seconds in plan.timings.values())
    assert plan.timings["total"] > 0
    assert isinstance(plan.refiner_stats, list)
    residuals = plan.residuals()
    assert residuals.hold, residuals.problems


def assert_same_plan(a, b):
    assert (a.status, a.cost, len(a.transitions)) == (b.status, b.cost, len(b.transitions))
    np.testing.assert_array_equal(a.poses, b.poses)
    for one, other in zip(a.transitions, b.transitions, strict=True):
        for name in ("grasp_ids", "q_pick", "q_place", "clearance"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_problem_contract(bottle_problem):
    problem = bottle_problem
    assert len(problem.grasps) == 200
    assert len(problem.placements) == 5
    for placement in problem.placements:
        assert placement.pose.shape == (4, 4)
        assert placement.margin >= 0.1
    feasible = problem.feasible_grasps(problem.placements[0].pose)
    assert feasible.shape == (200,) and feasible.dtype == bool


def test_status_values_are_sentences_that_say_what_to_try():
    assert {status.name for status in Status} == {
        "SOLVED", "START_INFEASIBLE", "GOAL_INFEASIBLE", "NOT_FOUND", "TIME_LIMIT",
    }  # fmt: skip
    for status in Status:
        assert "\n" not in status.value and len(status.value.split()) > 7
        assert status is Status.SOLVED or ";" in status.value or status.name.endswith("INFEASIBLE")


def test_a_plan_with_regrasps(bottle_problem, task, plan):
    assert not np.logical_and(*(bottle_problem.feasible_grasps(T) for T in (task.start, task.goal))).any()
    assert_contract(plan, bottle_problem, task)
    assert plan.cost == pytest.approx(numpy_cost(plan), abs=1e-9)
    assert plan.refiner_stats[-1]["num_regrasps"] == plan.num_regrasps
    assert set(plan.timings) == {"ends", "starts", "refine", "verify", "total"}
    assert plan.seed == 0 and plan.problem is bottle_problem


def test_ends_that_share_a_grasp_need_no_regrasp(bottle_problem, direct):
    plan = solve_sequence(bottle_problem, direct.start, direct.goal, max_regrasps=0)
    assert plan.num_regrasps == 0
    assert_contract(plan, bottle_problem, direct)
    assert len(plan.transitions[0].grasp_ids) == direct.shared
    assert plan.cost == pytest.approx(numpy_cost(plan), abs=1e-9)
    assert plan.refiner_stats == []


def test_no_plan_within_max_regrasps(bottle_problem, task):
    plan = solve_sequence(bottle_problem, task.start, task.goal, max_regrasps=0)
    assert_no_plan(plan, Status.NOT_FOUND)


def test_an_infeasible_end_is_named(few_grasps):
    problem, graspable, barren = few_grasps
    assert_no_plan(solve_sequence(problem, barren, graspable), Status.START_INFEASIBLE)
    assert_no_plan(solve_sequence(problem, graspable, barren), Status.GOAL_INFEASIBLE)


def test_the_time_limit_ends_the_search(bottle_problem, task):
    plan = solve_sequence(bottle_problem, task.start, task.goal, time_limit=1e-6)
    assert plan.status is Status.TIME_LIMIT and not plan.solved
    assert plan.transitions == ()
    np.testing.assert_allclose(plan.poses[[0, -1]], [task.start, task.goal], atol=1e-12)
    assert len(plan.xi) == len(plan.placements) == plan.num_regrasps <= 1
    assert solve_sequence(bottle_problem, task.start, task.goal, time_limit=600.0).solved


def assert_no_plan(plan, status):
    assert plan.status is status and not plan.solved
    assert plan.poses.shape == (2, 4, 4) and plan.num_regrasps == 0
    assert plan.transitions == () and plan.xi.shape == (0, 3) and plan.placements.shape == (0,)
    assert np.isnan(plan.cost)


SHORT_LANGEVIN = replace(as_recipe("langevin"), batches=(100,))


@pytest.mark.parametrize("refiner", ["ipopt", "lattice", SHORT_LANGEVIN], ids=["ipopt", "lattice", "langevin"])
def test_every_refiner_plans_and_repeats_itself(bottle_problem, task, refiner):
    plans = [solve_sequence(bottle_problem, task.start, task.goal, refiner=refiner, seed=4) for _ in range(2)]
    assert_contract(plans[0], bottle_problem, task)
    assert_same_plan(*plans)
    assert plans[0].cost == pytest.approx(numpy_cost(plans[0]), abs=1e-9)


def test_langevin_by_name_has_the_constants_of_the_paper():
    recipe = as_recipe("langevin")
    assert recipe.refiner == LangevinRefiner(iterations=20, eta=0.3, tau=0.1)
    assert (recipe.starts, recipe.batches, recipe.verified) == ("random", (1000,), 50)


def test_a_freshly_loaded_problem_gives_the_same_plan(task, plan):
    fresh = RegraspProblem.load("bottle", "nova2-w")
    assert_same_plan(solve_sequence(fresh, task.start, task.goal, seed=0), plan)


def test_cost_options_are_used(bottle_problem, task):
    options = CostOptions(alpha=0.5, lambda_reg=2.0)
    plan = solve_sequence(bottle_problem, task.start, task.goal, options=options)
    assert plan.cost == pytest.approx(numpy_cost(plan, 0.5, 2.0), abs=1e-9)


class Shifted:
    """A refiner of one's own: it moves every start by `step` along x and claims a low cost."""

    name = "shifted"

    def __init__(self, step):
        self.step, self.batches = step, []

    def refine(self, objective, starts, rng):
        assert isinstance(rng, np.random.Generator)
        self.batches.append(len(starts))
        moved = Candidates(starts.placements, starts.xi + np.array([self.step, 0.0, 0.0]), starts.cost - 1e6)
        return replace(LatticeRefiner().refine(objective, starts, rng), candidates=moved, stats={"step": self.step})


def test_a_refiner_of_ones_own(bottle_problem, task):
    refiner = Shifted(1e-4)
    plan = solve_sequence(bottle_problem, task.start, task.goal, refiner=refiner)
    assert_contract(plan, bottle_problem, task)
    assert refiner.batches and all(refiner.batches)
    assert plan.refiner_stats[0]["refiner"] == "shifted" and plan.refiner_stats[0]["step"] == 1e-4
    assert plan.cost == pytest.approx(numpy_cost(plan), abs=1e-9)


@pytest.mark.parametrize("step", [-0.4, 5.0, np.nan])
def test_poses_that_a_refiner_claims_are_verified(bottle_problem, task, step):
    plan = solve_sequence(bottle_problem, task.start, task.goal, refiner=Shifted(step), max_regrasps=1)
    if plan.solved:
        assert plan.residuals().hold, plan.residuals().problems


def test_a_pose_outside_the_workspace_is_not_accepted(bottle_problem):
    problem, rng = bottle_problem, np.random.default_rng(5)
    while True:
        task = random_task(problem, rng, needs_regrasp=True)
        plan = solve_sequence(problem, task.start, task.goal, refiner="lattice")
        centers = plan.poses[[0, -1], :3, :3] @ problem.object.center_of_mass + plan.poses[[0, -1], :3, 3]
        low, high = centers[:, :2].min(axis=0) - 1e-3, centers[:, :2].max(axis=0) + 1e-3
        if ((plan.xi[:, :2] < low) | (plan.xi[:, :2] > high)).any():
            break
    bounds = replace(problem.workcell.bounds, x=(low[0], high[0]), y=(low[1], high[1]))
    narrow = replace(problem, workcell=problem.workcell.within(bounds))
    vars(narrow).update(energy=problem.energy, lattice=problem.lattice)  # the cached ones, of the wide workspace

    class Stubborn(Shifted):
        def refine(self, objective, starts, rng):
            claimed = Candidates(plan.placements[None], plan.xi[None], np.array([-1e6]))
            return replace(LatticeRefiner().refine(objective, starts, rng), candidates=claimed)

    recipe = Recipe(Stubborn(0.0), fallback=0)
    again = solve_sequence(narrow, task.start, task.goal, refiner=recipe, max_regrasps=plan.num_regrasps)
    assert again.status is Status.NOT_FOUND


def test_an_unknown_refiner_lists_the_known_ones(bottle_problem, task):
    with pytest.raises(UnknownNameError) as info:
        solve_sequence(bottle_problem, task.start, task.goal, refiner="ipot")
    assert info.value.alternatives[0] == "ipopt"
    assert {"ipopt", "langevin", "lattice"} <= set(info.value.alternatives)
    with pytest.raises(OptionError, match="has no method 'refine'"):
        solve_sequence(bottle_problem, task.start, task.goal, refiner=object())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"max_regrasps": -1}, "max_regrasps is -1"),
        ({"max_regrasps": 9}, "max_regrasps is 9"),
        ({"max_regrasps": 1.5}, "max_regrasps is 1.5"),
        ({"max_regrasps": None}, "max_regrasps is None"),
        ({"time_limit": 0.0}, "time_limit is 0.0"),
        ({"time_limit": -1.0}, "time_limit is -1.0"),
        ({"time_limit": float("nan")}, "time_limit is nan"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 0.5}, "seed is 0.5"),
    ],
)
def test_options_outside_their_range(bottle_problem, task, options, said):
    with pytest.raises(OptionError, match=said) as info:
        solve_sequence(bottle_problem, task.start, task.goal, **options)
    assert "\n" not in str(info.value)
