"""What a search may use, exact numbers of regrasps, and alternatives: results obey them, and numbers stay the same."""

import numpy as np
import pytest

from regrasp_opt.errors import OptionError, UnknownNameError
from regrasp_opt.planning import RegraspProblem, solve_sequence
from regrasp_opt.planning.alternatives import Alternatives, differ
from regrasp_opt.planning.filters import from_above
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="module")
def problem():
    return RegraspProblem.load("bottle", "nova2-w")


@pytest.fixture(scope="module")
def tasks(problem):
    rng = np.random.default_rng(11)
    return [random_task(problem, rng, needs_regrasp=True) for _ in range(3)]


@pytest.mark.parametrize("refiner", ["ipopt", "lattice", "exact", "langevin-ipopt"])
def test_placements_are_kept_to(problem, tasks, refiner):
    for start, goal, _ in tasks[:2]:
        used = solve_sequence(problem, start, goal).placements.tolist()
        plan = solve_sequence(problem, start, goal, refiner, placements=used)
        assert plan.solved and set(plan.placements) <= set(used) and plan.num_regrasps == len(used)
        assert plan.problem is problem and plan.residuals().hold
        others = set(range(len(problem.placements))) - set(used)
        plan = solve_sequence(problem, start, goal, refiner, placements=others, max_regrasps=1)
        assert not plan.solved or set(plan.placements) <= others


@pytest.mark.parametrize("refiner", ["ipopt", "exact"])
def test_masked_grasps_are_not_used(problem, tasks, refiner):
    for start, goal, _ in tasks:
        shared = [set(t.grasp_ids.tolist()) for t in solve_sequence(problem, start, goal, refiner).transitions]
        mask = np.isin(np.arange(len(problem.grasps)), [max(ids) for ids in shared])
        for grasps in (mask, np.flatnonzero(mask).tolist()):
            plan = solve_sequence(problem, start, goal, refiner, grasps=grasps)
            assert all(mask[t.grasp_ids].all() for t in plan.transitions)
            assert not plan.solved or plan.residuals().hold
    assert plan.solved


def test_a_choice_of_grasps_holds_at_both_poses_of_a_transition(problem):
    rng, chosen, found = np.random.default_rng(2), from_above(1.0), 0
    for _ in range(6):
        start, goal, _ = random_task(problem, rng)
        try:
            plan = solve_sequence(problem, start, goal, grasps=chosen, max_regrasps=2)
        except OptionError as error:
            assert "grasps leaves none of the" in str(error)
            continue
        found += plan.solved
        for i, transition in enumerate(plan.transitions):
            for T in plan.poses[i : i + 2]:
                assert chosen(T @ problem.grasps.T_object_tcp[transition.grasp_ids]).all()
    assert found


@pytest.mark.parametrize("refiner", ["ipopt", "exact"])
@pytest.mark.parametrize("count", [1, 2])
def test_a_number_of_regrasps_is_exact(problem, tasks, refiner, count):
    plan = solve_sequence(problem, problem.pose(0, -0.2, 0.4), problem.pose(0, -0.2, 0.4), refiner, num_regrasps=count)
    assert plan.solved and plan.num_regrasps == count and plan.residuals().hold


def test_no_regrasp_is_a_number_as_well(problem, tasks):
    assert not solve_sequence(problem, *tasks[0][:2], num_regrasps=0).solved


def test_alternatives_differ_from_each_other(problem, tasks):
    plan = solve_sequence(problem, *tasks[0][:2], alternatives=3)
    plans = [plan, *plan.alternatives]
    assert len(plans) == 4 and all(other.solved and other.residuals().hold for other in plans)
    assert all(differ(a, b) for i, a in enumerate(plans) for b in plans[:i])
    assert max(other.num_regrasps for other in plans) <= plan.num_regrasps + 1
    assert np.array_equal(plan.poses, solve_sequence(problem, *tasks[0][:2]).poses)


def test_alternatives_are_accepted_one_by_one(problem, tasks):
    plan = solve_sequence(problem, *tasks[0][:2], alternatives=2, accept=lambda plan: 4 in plan.placements)
    assert all(4 in other.placements for other in (plan, *plan.alternatives))


def test_a_callers_condition_is_asked_about_every_plan(problem, tasks):
    """What the caller refuses says nothing about other poses in the same placements."""
    others = Alternatives(1, lambda plan: False)
    plan = solve_sequence(problem, *tasks[0][:2])
    assert not any(others(plan) for _ in range(10)) and not others.tried(plan.placements)
    alike = Alternatives(1, None)
    assert not any(alike(plan) for _ in range(4)) and alike.tried(plan.placements)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"placements": [9]}, OptionError, "there is no placement 9"),
        ({"placements": []}, OptionError, "leave no way to put the object down"),
        ({"supports": ["shelf"]}, UnknownNameError, "shelf"),
        ({"grasps": np.zeros(200, dtype=bool)}, OptionError, "leaves none of the grasps"),
        ({"grasps": np.ones(3, dtype=bool)}, OptionError, "give a mask"),
        ({"grasps": [500]}, OptionError, "give a mask"),
        ({"grasps": lambda T: np.zeros(len(T), dtype=bool)}, OptionError, "leaves none of the"),
        ({"grasps": lambda T: np.ones(3, dtype=bool)}, OptionError, "return True or False for each"),
        ({"grasps": lambda T: np.full(len(T), np.nan)}, OptionError, "of float64 for"),
        ({"grasps": np.ones(200, dtype=int)}, OptionError, "a number twice; give each once, or a mask"),
        ({"placements": ["a", 7]}, OptionError, "give whole numbers"),
        ({"placements": 9}, OptionError, "there is no placement 9"),
        ({"num_regrasps": 9}, OptionError, "num_regrasps is 9; give a whole number from 0 to 8"),
        ({"alternatives": -1}, OptionError, "alternatives is -1"),
    ],
)
def test_what_leaves_nothing_is_refused(problem, tasks, options, error, said):
    with pytest.raises(error, match=said):
        solve_sequence(problem, *tasks[0][:2], **options)
