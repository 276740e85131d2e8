"""Fixtures of the motion tests: a plan with one regrasp and its motion."""

import numpy as np
import pytest

from regrasp_opt import solve_sequence
from regrasp_opt.motion import plan_motion
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="session")
def bottle_plan(bottle_problem):
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(bottle_problem, task.start, task.goal, seed=0)
    assert plan.num_regrasps >= 1
    return plan


@pytest.fixture(scope="session")
def motion(bottle_plan):
    found = plan_motion(bottle_plan)
    assert found.solved, found.reason
    return found
