"""The meshes beside the project, where they are: their placements, and the whole path from mesh to plan."""

from pathlib import Path

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, load_object, load_workcell, prepare, solve_sequence
from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.grasps import rejected_grasps, sample_grasps
from regrasp_opt.planning.tasks import random_task

OBJECTS = Path(__file__).parents[3] / "shared" / "objects"
pytestmark = pytest.mark.skipif(not OBJECTS.is_dir(), reason=f"{OBJECTS} is not there")


@pytest.mark.parametrize(("name", "count"), [("bunny", 7), ("pentagon", 7), ("mug", 2)])
def test_as_many_placements_as_in_the_paper(name, count):
    model = load_object(OBJECTS / f"{name}.stl")
    assert sum(placement.margin >= 0.1 for placement in model.placements) == count
    for placement in model.placements:
        heights = model.vertices @ placement.pose[2, :3] + placement.pose[2, 3]
        assert heights.min() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "tool"), [("mug", "w"), ("bunny", "s3"), ("ycb/mustardbottle", "r140"), ("ycb/tomatosoupcan", "s2")]
)
def test_what_the_sampler_makes_of_scans_holds(name, tool):
    model, effector = load_object(OBJECTS / f"{name}.stl"), load_end_effector(tool)
    assert rejected_grasps(sample_grasps(model, effector, 30, seed=2), model, effector) == {}


def test_from_a_mesh_to_a_plan(tmp_path):
    mesh = OBJECTS / "pentagon.stl"
    folder, report = prepare(
        load_object(mesh), load_workcell("nova2-w"), samples=300, num_grasps=40, out=tmp_path / "model", jobs=1
    )
    assert report["placements"] == 7 and report["feasible_pairs"] >= 300
    problem = RegraspProblem.load(mesh, "nova2-w", model=folder)
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(problem, task.start, task.goal)
    assert plan.solved and plan.num_regrasps >= 1
    plan.save(tmp_path / "plan.json")
    assert type(plan).load(tmp_path / "plan.json").residuals().hold
