"""Every experiment, at a size of seconds, on the bottle and on a folder with a broken mesh."""

import json

import numpy as np
import pytest

from regrasp_opt.benchmarks.comparisons import ablations, joint, refiners
from regrasp_opt.benchmarks.harness import session as session_module
from regrasp_opt.benchmarks.harness import subjects
from regrasp_opt.benchmarks.harness.oracle import Resolution
from regrasp_opt.benchmarks.harness.report import write_report
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.paper import cost_sweep, cross_effector, hard_tiers, multi_step, one_step
from regrasp_opt.benchmarks.paper.published import CROSS_EFFECTOR, END_EFFECTORS, MULTI_STEP, ONE_STEP
from regrasp_opt.cli.app import run
from regrasp_opt.cli.bench import EXPERIMENTS
from regrasp_opt.connectivity import CostOptions, block, exact_energy, sequence_cost
from regrasp_opt.conventions import planar_transform
from regrasp_opt.energy.model import GraspEnergy

COARSE = Resolution(0.15, 4)


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setattr(session_module, "QUICK_GRID", COARSE)
    return Session(tmp_path, quick=True, names=("bottle",), jobs=1, quiet=True)


def check(report, session):
    """Write the report, and return its measured rows."""
    summary = write_report(report, session.folder / report.name)
    assert summary["errors"] == [] and all(table["rows"] or table["note"] for table in summary["tables"])
    assert set(summary["instances"]) and len(summary["revisions"]) == 1
    return report.rows


def test_one_step(session, monkeypatch):
    monkeypatch.setattr(one_step, "PAIRS", {True: 1})
    kept = {name: one_step.METHODS[name] for name in ("ours J",)}
    monkeypatch.setattr(one_step, "METHODS", kept)
    rows = check(one_step.run_one_step(session), session)
    ours = [row for row in rows if row.get("method") == "ours J" and "sv" in row]
    assert [row["k_top"] for row in ours] == list(one_step.K_TOP)
    assert all(row["distinct"] == row["k_top"] and not row["direct"] for row in ours)
    assert all(row["sv"] > 0.9 for row in ours)
    assert one_step.run_one_step(session).rows == rows


def test_unseen_grasps(session, monkeypatch):
    monkeypatch.setattr(one_step, "PAIRS", {True: 1})
    monkeypatch.setattr(one_step, "UNSEEN_METHODS", ("ours J",))
    rows = check(one_step.run_unseen(session), session)
    assert max(row["sv"] for row in rows if "sv" in row) > 0.8


def test_cost_sweep(session, monkeypatch):
    monkeypatch.setattr(cost_sweep, "SUMS", {True: 2})
    monkeypatch.setattr(cost_sweep, "PAIRS", {True: 1})
    rows = check(cost_sweep.run_cost_sweep(session), session)
    steps = [row for row in rows if row.get("grasps") == 200]
    assert [row["step"] for row in steps] == list(range(cost_sweep.STEPS))
    # no grasp is shared by the ends of a pair that needs a regrasp
    assert all(row["shared_all"] == 0 for row in steps)
    assert steps[0]["shared_goal"] > 0 and steps[-1]["shared_start"] > 0
    assert all(row["J+"] <= row["J"] + 1e-9 for row in steps)


def test_multi_step(session, monkeypatch):
    monkeypatch.setattr(multi_step, "PAIRS", {True: 2})
    rows = check(multi_step.run_multi_step(session), session)
    ours = [row for row in rows if row["planner"] == "ours"]
    assert len(ours) == 2 and all(row["solved"] for row in ours)
    assert all(row["num_regrasps"] >= 1 and row["bottleneck"] >= 1 and row["clearance_mm"] > 0 for row in ours)


def test_hard_tiers_and_refiners_share_their_instances(session, monkeypatch):
    monkeypatch.setattr(hard_tiers, "TIME_LIMIT", 2.0)
    monkeypatch.setattr(refiners, "TIME_LIMIT", {True: 10.0})
    monkeypatch.setattr(refiners, "PAIRS", {True: 1})
    kept = {name: refiners.PLANNERS[name] for name in ("ipopt from lattice", "lattice")}
    monkeypatch.setattr(refiners, "PLANNERS", kept)
    tiers = check(hard_tiers.run_hard_tiers(session), session)
    rows = check(refiners.run_refiners(session), session)
    assert {row["tier"] for row in tiers} >= {"1", "unsolvable"}
    assert all(row["status"] in ("solved", "not_found", "time_limit") for row in tiers)
    hard = {row["pair"] for row in rows if row["condition"] != "all grasps"}
    assert hard <= {row["pair"] for row in tiers}
    graph = [row for row in rows if row["planner"] == refiners.GRAPH]
    assert graph and all(row["num_regrasps"] == row["minimum"] for row in graph)


def test_cross_effector(session, monkeypatch):
    tiny = cross_effector.TransferSizes(("w", "s1"), 1, 1, 500, Resolution(0.2, 4))
    monkeypatch.setattr(cross_effector, "QUICK", tiny)
    monkeypatch.setattr(subjects, "HELD_OUT_POSES", 50)
    report = cross_effector.run_cross_effector(session)
    rows = check(report, session)
    tools = ("w", "s1")
    assert {(row["trained"], row["tested"]) for row in rows} == {(a, b) for a in ("constant", *tools) for b in tools}
    lines = {line[0]: line[1:] for line in report.tables[0].rows}
    assert list(lines) == ["constant", *tools, "own"] and report.tables[0].columns == ("trained", *tools)
    assert lines["own"] == (lines["w"][0], lines["s1"][1])


def test_the_control_across_end_effectors_knows_only_ends_and_table(bottle_problem, session):
    """Its cost is that of Eq. 5, and depends on how many grasps of each end the table leaves."""
    oracle = session.oracle("bottle", bottle_problem)
    ends = np.array([bottle_problem.pose(0, -0.25, 0.40, 0.5), bottle_problem.pose(1, 0.28, 0.38, 2.1)])
    feasible = np.array([bottle_problem.feasible_grasps(T) for T in ends])
    rule = bottle_problem.table_rule(oracle.placements, oracle.xi)
    control = GraspEnergy(cross_effector.constant_energy(), bottle_problem.grasps)
    costs = []
    for energy in (control, bottle_problem.energy):
        [cost] = cross_effector.bridge_costs(bottle_problem, energy, oracle, feasible[None])
        learned = block(energy(planar_transform(oracle.xi) @ bottle_problem.placement_poses[oracle.placements]), rule)
        chains = np.array([[exact_energy(feasible[0]), e, exact_energy(feasible[1])] for e in learned])
        np.testing.assert_allclose(cost, sequence_cost(chains, CostOptions()), rtol=1e-4)
        costs.append(cost)
    left = np.array([(~rule & end).sum(axis=1) for end in feasible], dtype=float)
    both = (left > 0).all(axis=0)
    Q = np.log(2) - np.log(left[:, both])
    assert 0 < both.sum() < len(both)
    np.testing.assert_allclose(costs[0][both], Q.sum(axis=0) + 0.5 * (Q[0] - Q[1]) ** 2, rtol=1e-5)
    assert np.ptp(costs[1][both]) > 1 > np.ptp(costs[0][both])


def test_ablations(session, monkeypatch):
    monkeypatch.setattr(ablations, "PAIRS", {True: 1})
    monkeypatch.setattr(ablations, "SAMPLES", {True: 2_400})
    monkeypatch.setattr(subjects, "HELD_OUT_POSES", 50)
    kept = {name: ablations.VARIANTS[name] for name in ("default", "samples / 4", "lambda_reg 0", "grasps 50")}
    monkeypatch.setattr(ablations, "VARIANTS", kept)
    rows = check(ablations.run_ablations(session), session)
    ap = {row["variant"]: row["ap"] for row in rows if "ap" in row}
    assert ap["default"] == ap["lambda_reg 0"] > ap["samples / 4"]


def test_a_broken_mesh_is_a_row_and_the_rest_runs_on(session, tmp_path, monkeypatch):
    monkeypatch.setattr(cost_sweep, "SUMS", {True: 1})
    monkeypatch.setattr(cost_sweep, "PAIRS", {True: 0})
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "broken.stl").write_text("solid nothing", encoding="utf-8")
    with_broken = Session(session.folder, quick=True, objects=meshes, names=("bottle",), jobs=1, quiet=True)
    report = cost_sweep.run_cost_sweep(with_broken)
    assert [row["object"] for row in report.errors] == ["broken.stl"]
    assert any(row["object"] == "bottle" and "ap_shared" in row for row in report.rows)


def test_the_command_names_what_is_wrong(tmp_path, capsys):
    assert run(["bench", "one-stop", "--out", str(tmp_path)]) == 2
    assert "one-step" in capsys.readouterr().err
    assert run(["bench", "one-step", "--objects", str(tmp_path / "none"), "--out", str(tmp_path)]) == 2
    assert "is not a folder" in capsys.readouterr().err
    assert run(["bench", "one-step", "--objects", str(tmp_path), "--out", str(tmp_path)]) == 2
    assert "no mesh" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_its_files(session, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(EXPERIMENTS, "cost-sweep", lambda s: cost_sweep.run_cost_sweep(session))
    monkeypatch.setattr(cost_sweep, "SUMS", {True: 1})
    monkeypatch.setattr(cost_sweep, "PAIRS", {True: 1})
    assert run(["bench", "cost-sweep", "--quick", "--out", str(tmp_path)]) == 0
    assert "AP shared" in capsys.readouterr().out
    summary = json.loads((tmp_path / "cost-sweep" / "summary.json").read_text(encoding="utf-8"))
    assert summary["name"] == "cost-sweep" and (tmp_path / "benchmarks.md").is_file()
    assert (tmp_path / "cost-sweep" / "cost-sweep.md").read_text("utf-8").startswith("# Energy compositionality")


def test_the_papers_tables_are_whole():
    assert {len(rows) for rows in ONE_STEP.values()} == {4} and {len(rows) for rows in MULTI_STEP.values()} == {2}
    cells = [CROSS_EFFECTOR[name][a][b] for name in CROSS_EFFECTOR for a in END_EFFECTORS for b in END_EFFECTORS]
    assert len(cells) == 144 and all(0 <= cell <= 100 for cell in cells)
    # in the paper the same tool wins every row of the bottle
    assert all(CROSS_EFFECTOR["bottle"][a][a] >= 40 for a in END_EFFECTORS)


def test_blocks_of_end_effectors_leave_the_same_tool_out():
    values = {
        (a, b): 0.9 if a == b else 0.1 * (1 + END_EFFECTORS.index(a) // 3) for a in END_EFFECTORS for b in END_EFFECTORS
    }
    values |= {("constant", tested): 0.15 for tested in END_EFFECTORS}
    rows = [{"object": "mug.stl", "trained": a, "tested": b, "sv": sv} for (a, b), sv in values.items()]
    lines = {line[1]: line[2:] for line in cross_effector._blocks(rows, []).rows}
    assert all(line[0] == 15 and line[2] == 90 for line in lines.values())
    assert {block: line[4:6] for block, line in lines.items()} == {
        "same tool": (0, 6), "grippers to grippers": (6, 6), "grippers to suction": (9, 9),
        "suction to grippers": (0, 9), "suction to suction": (0, 6),
    }  # fmt: skip
    means = {block: line[1] for block, line in lines.items()}
    assert means == {
        "same tool": 90, "grippers to grippers": 10, "grippers to suction": 10,
        "suction to grippers": 20, "suction to suction": 20,
    }  # fmt: skip
    printed = CROSS_EFFECTOR["mug"]
    assert lines["suction to suction"][6] == pytest.approx(
        np.mean([printed[a][b] for a in ("s1", "s2", "s3") for b in ("s1", "s2", "s3") if a != b]), abs=0.05
    )


def test_joint_problem_and_free_grasps(session, monkeypatch):
    monkeypatch.setattr(joint, "PAIRS", {True: 1})
    monkeypatch.setattr(joint, "THINNED", {True: 2})
    monkeypatch.setattr(joint, "MAX_REGRASPS", 1)
    report = joint.run_joint(session)
    rows = check(report, session)
    refined = {row["measure"]: row for row in rows if "after" in row}
    assert set(refined) == set(joint.MEASURES)
    assert refined["travel"]["after"] <= refined["travel"]["discrete"] <= refined["travel"]["before"]
    assert refined["clearance"]["after"] >= refined["clearance"]["before"]
    thinned = [row for row in rows if row["measure"] == "free grasps"]
    assert len(thinned) == 2 and any(row["counts"] for row in thinned)
    assert all(row["verified"] == (row["status"] == "solved") for row in thinned if row["counts"])
    share = next(row for row in report.tables[-1].rows if row[0] == "all")[3]
    counted = [row["status"] == "solved" for row in thinned if row["counts"]]
    assert share == pytest.approx(100 * sum(counted) / len(counted))
