"""Fixtures of the planning tests: a solved plan with one regrasp, and its file."""

import json

import numpy as np
import pytest

from regrasp_opt import solve_sequence
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="session")
def task(bottle_problem):
    """Return a bottle task whose ends share no grasp."""
    return random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)


@pytest.fixture(scope="session")
def plan(bottle_problem, task):
    """Return the plan of `task`."""
    solved = solve_sequence(bottle_problem, task.start, task.goal, seed=0)
    assert solved.num_regrasps >= 1
    return solved


@pytest.fixture(scope="session")
def plan_content(plan, tmp_path_factory):
    """Return what the file of `plan` holds."""
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    plan.save(path)
    return json.loads(path.read_text("utf-8"))
