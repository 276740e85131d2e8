"""Fixtures that several layers share: small random energies, and the built-in bottle problem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from transforms import random_transforms

from regrasp_opt.energy.features import feature_count
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.grasps import GraspSet


@pytest.fixture(scope="session", autouse=True)
def _own_data_home(tmp_path_factory):
    """Keep caches and prepared models of tests out of the user's folders, but shared between tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REGRASP_OPT_HOME", str(tmp_path_factory.getbasetemp() / "data-home"))
        yield


@pytest.fixture
def make_energy() -> Callable[..., GraspEnergy]:
    """Return a maker of random energies; weights are large enough for the activations to bend."""

    def make(grasps=12, hidden=8, activation="silu", features="tcp", bounded=True, use_width=True, seed=0):
        rng = np.random.default_rng(seed)
        shapes = [(hidden, feature_count(features, use_width)), (hidden, hidden), (1, hidden)]
        weights = tuple((1.5 * rng.normal(size=s) / np.sqrt(s[1])).astype(np.float32) for s in shapes)
        biases = tuple((0.3 * rng.normal(size=s[0])).astype(np.float32) for s in shapes)
        model = EnergyModel(weights, biases, activation, features, use_width, bounded, 1.0)
        widths = rng.uniform(0.01, 0.1, grasps)
        return GraspEnergy(model, GraspSet(random_transforms(rng, grasps), widths, "parallel"))

    return make


@pytest.fixture(scope="session")
def bottle_problem():
    """Return the built-in bottle problem with its bundled model."""
    from regrasp_opt import RegraspProblem

    return RegraspProblem.load("bottle", "nova2-w")


@pytest.fixture(scope="session")
def bottle_plan(bottle_problem):
    """Return a plan with one regrasp."""
    from regrasp_opt import solve_sequence
    from regrasp_opt.planning.tasks import random_task

    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(bottle_problem, task.start, task.goal, seed=0)
    assert plan.num_regrasps >= 1
    return plan


@pytest.fixture(scope="session")
def motion(bottle_plan):
    """Return the motion of that plan."""
    from regrasp_opt.motion import plan_motion

    found = plan_motion(bottle_plan)
    assert found.solved, found.reason
    return found
