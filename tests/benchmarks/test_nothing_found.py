"""What an experiment writes where there is nothing to measure: no plan, no motion, no grasp that is left."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from regrasp_opt.benchmarks.comparisons import ablations, joint, motion
from regrasp_opt.benchmarks.harness import subjects
from regrasp_opt.benchmarks.harness.instances import Instance
from regrasp_opt.benchmarks.harness.oracle import Resolution
from regrasp_opt.benchmarks.harness.planners import graph_row, plan_row
from regrasp_opt.benchmarks.harness.report import Report, Table
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.harness.subjects import TrainingRequest, trained_energies
from regrasp_opt.benchmarks.paper import cost_sweep, hard_tiers, one_step
from regrasp_opt.cli.app import run
from regrasp_opt.cli.bench import EXPERIMENTS
from regrasp_opt.energy.training import TrainingOptions
from regrasp_opt.errors import GraspError
from regrasp_opt.motion import MotionPlan, MotionStatus
from regrasp_opt.planning.prepare import prepare
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="module")
def pair(bottle_problem):
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    return Instance("bottle/0", task.start, task.goal, 1)


@pytest.fixture(scope="module")
def apart(bottle_problem, pair):
    """The bottle with one grasp for each end of the pair, which no pose holds both of."""
    feasible = [bottle_problem.feasible_grasps(T) for T in pair.ends]
    ids = [int(np.flatnonzero(row)[0]) for row in feasible]
    return replace(bottle_problem, grasps=bottle_problem.grasps.subset(ids))


@pytest.fixture(scope="module")
def useless(bottle_problem, pair):
    """The bottle with one grasp that is feasible at neither end of the pair."""
    some = [bottle_problem.feasible_grasps(T) for T in pair.ends]
    return replace(bottle_problem, grasps=bottle_problem.grasps.subset(np.flatnonzero(~(some[0] | some[1]))[:1]))


def test_motion_has_one_row_with_the_status_where_there_is_no_plan(apart, pair, tmp_path):
    [row] = motion.motion_row(apart, pair, 0, tmp_path)
    assert (row["status"], row["solved"], row["num_regrasps"]) == ("not_found", False, None) and "moves" not in row


def unmoved(plan):
    return MotionPlan(MotionStatus.NO_MOTION, "a wall", plan, (), *[np.ones(6)] * 2, 0.0)


def test_motion_plans_again_where_the_first_plan_cannot_be_moved(bottle_problem, pair, monkeypatch, tmp_path):
    plan_motion, calls = motion.plan_motion, []

    def not_at_first(plan, options=None):
        calls.append(plan)
        return unmoved(plan) if len(calls) == 1 else plan_motion(plan, options)

    monkeypatch.setattr(motion, "plan_motion", not_at_first)
    [row] = motion.motion_row(bottle_problem, pair, 0, tmp_path)
    assert (row["first_moves"], row["reason"], row["moves"]) == (False, "a wall", True)
    monkeypatch.setattr(motion, "plan_motion", lambda plan, options: unmoved(plan))
    monkeypatch.setattr(motion, "plan_with_motion", lambda *_, **__: unmoved(calls[0]))
    [row] = motion.motion_row(bottle_problem, pair, 0, tmp_path)
    assert row["solved"] and not row["moves"] and "duration" not in row


def test_the_joint_problem_has_a_row_for_each_measure_where_there_is_no_plan(apart, pair):
    rows = joint.refined_rows(apart, pair, 0)
    assert rows == [{"measure": measure, "status": "not_found"} for measure in joint.MEASURES]


def test_thinned_pairs_count_only_where_the_whole_set_holds_a_plan(bottle_problem, apart, pair):
    everything, first = np.arange(len(bottle_problem.grasps)), np.arange(1)
    for problem, ids, status in ((bottle_problem, everything, "solved"), (apart, first, "goal_infeasible")):
        assert joint.thinned_rows(problem, pair, ids, 0) == [
            {"measure": "free grasps", "thinned status": status, "counts": False}
        ]


def test_the_graph_and_the_planner_say_that_there_is_no_plan(bottle_problem, apart, pair):
    ids = np.array([int(np.flatnonzero((bottle_problem.grasps.T_object_tcp == T).all(axis=(1, 2)))[0])
                    for T in apart.grasps.T_object_tcp])  # fmt: skip
    [row] = graph_row(apart, pair, bottle_problem, ids, Resolution(0.2, 2))
    assert (row["status"], row["solved"], row["num_regrasps"]) == ("not_found", False, None) and "bottleneck" not in row
    [row] = plan_row(apart, pair, "lattice", 0, 20.0)
    assert (row["status"], row["solved"], row["first_verified"]) == ("not_found", False, None)


def test_pairs_whose_ends_no_grasp_reaches_are_skipped_with_the_reason(useless, pair, monkeypatch):
    said = "no grasp of this set is feasible at one of the ends"
    assert one_step.measure_pair(useless, pair, "ours J", 0, 2, False) == [{"skipped": said}]
    model = replace(useless.energy.model, metadata={"held_out": {"average_precision": 0.5, "shared_f1": 0.5}})
    first, second = ablations.measure_variant(useless, model, "default", [pair], 0)
    assert first == {"ap": 0.5, "shared_f1": 0.5} and second == {"pair": pair.name, "skipped": said}


def test_costs_that_do_not_change_along_a_sweep_agree_with_nothing():
    rows = [{"J": 1.0, "shared_start": k, "shared_goal": 3 - k} for k in range(4)]
    assert cost_sweep.sweep_row(rows, "J")["agreement"] == 0.0


def test_workcells_without_a_model_are_left_out_of_the_hard_tiers(bottle_problem, tmp_path, monkeypatch):
    session = Session(tmp_path, quick=True, names=("bottle",), jobs=1, quiet=True)
    cells = []

    def prepared(self, problem, cell):
        cells.append(cell)
        if len(cell.obstacles) == 3:
            raise GraspError("no grasp is left")
        return replace(problem, workcell=cell)

    monkeypatch.setattr(Session, "prepared", prepared)
    sizes = replace(hard_tiers.QUICK, workcells=True, grasps=(5,))
    found = list(hard_tiers.conditions(session, bottle_problem, sizes))
    count = len(bottle_problem.grasps)
    assert [c.label for c in found] == [
        "table, 5 grasps, set 0", "table, 5 grasps, set 1", f"narrow, {count} grasps", "narrow, 5 grasps, set 0",
    ]  # fmt: skip
    assert [len(c.reduced.grasps) for c in found] == [5, 5, count, 5] and len(cells) == 2
    (x_low, x_high), (y_low, y_high) = cells[1].bounds.x, cells[1].bounds.y
    assert x_high - x_low == pytest.approx(0.2) and y_high - y_low == pytest.approx(0.2)
    whole = bottle_problem.workcell.bounds
    assert whole.x[0] <= x_low and x_high <= whole.x[1] and whole.y[0] <= y_low and y_high <= whole.y[1]


def test_a_mesh_is_prepared_once_and_again_when_its_model_is_broken(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path / "home"))
    calls = []

    def small(*args, **options):
        calls.append(args)
        return prepare(*args, **options, samples=200, num_grasps=15)

    monkeypatch.setattr(subjects, "prepare", small)
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    trimesh.creation.box((0.04, 0.05, 0.1)).export(meshes / "part.stl")
    trimesh.creation.box((0.4, 0.4, 0.4)).export(meshes / "wide.stl")
    session = Session(tmp_path, objects=meshes, names=(), jobs=1, quiet=True)
    problems, [wide] = session.subjects()
    [(name, part)] = problems.items()
    assert name == "part.stl" and len(part.energy) == len(part.grasps) and len(calls) == 2
    assert wide["object"] == "wide.stl" and "grasp" in wide["error"]
    stored = part.model_folder / "energy.safetensors"
    assert session.subjects()[0]["part.stl"].model_folder == stored.parent and len(calls) == 3
    stored.write_bytes(b"broken")
    with caplog.at_level(logging.WARNING):
        assert len(session.subjects()[0]["part.stl"].energy) > 0
    assert "it is made again" in caplog.text and len(calls) == 5


def test_a_broken_energy_is_trained_again(bottle_problem, tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path))
    monkeypatch.setattr(subjects, "HELD_OUT_POSES", 30)
    request = TrainingRequest(bottle_problem, TrainingOptions(hidden=8, epochs=2), 200)
    told = []
    [first] = trained_energies([request], jobs=1, progress=lambda done, total: told.append((done, total)))
    assert told == [(0, 1), (1, 1)] and request.path.is_file()
    request.path.write_bytes(b"broken")
    with caplog.at_level(logging.WARNING):
        [again] = trained_energies([request], jobs=1)
    assert "is corrupt; it is made again" in caplog.text
    assert all((a == b).all() for a, b in zip(first.weights, again.weights, strict=True))
    assert trained_energies([request], jobs=1)[0].threshold == first.threshold


def test_the_command_names_what_could_not_be_measured(tmp_path, monkeypatch, capsys):
    rows = [{"object": "part.stl", "error": "it has no [stable] placement"}]
    report = Report("cost-sweep", "Cost sweep", "", (Table("Empty", ("object",), (), "nothing"),), rows)
    monkeypatch.setitem(EXPERIMENTS, "cost-sweep", lambda session: report)
    assert run(["bench", "cost-sweep", "--out", str(tmp_path)]) == 0
    assert "part.stl: it has no [stable] placement" in capsys.readouterr().out
    assert run(["bench", "cost-sweep", "--out", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["errors"] == rows
