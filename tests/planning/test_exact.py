"""Planning without an energy: any mesh plans with nothing prepared, and paths are the shortest and widest there are."""

import itertools

import networkx
import numpy as np
import pytest
import trimesh
from oracles.cells import write_cell
from verifying import motion_findings, plan_problems

from regrasp_opt import RegraspPlan, RegraspProblem, Status, solve_sequence
from regrasp_opt.connectivity import exact_energy, sequence_cost
from regrasp_opt.errors import OptionError
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.motion import MotionStatus, plan_motion
from regrasp_opt.planning import search
from regrasp_opt.planning.exact import RestingPoses
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="module")
def brick(tmp_path_factory):
    """Return a problem of a mesh that nothing was prepared for."""
    path = tmp_path_factory.mktemp("brick") / "brick.stl"
    trimesh.creation.box((0.05, 0.08, 0.14)).export(path)
    return RegraspProblem.load(path, "nova2-w")


@pytest.fixture(scope="module")
def task(brick):
    return random_task(brick, np.random.default_rng(0), needs_regrasp=True)


@pytest.fixture(scope="module")
def plan(brick, task):
    return solve_sequence(brick, task.start, task.goal, "exact", seed=3)


def poses_with(feasible):
    """Return resting poses that are numbered by their x and have these feasible grasps (P, G)."""
    poses = object.__new__(RestingPoses)
    poses.feasible, poses.numbers = np.asarray(feasible, dtype=bool), np.arange(len(feasible))
    poses.xi = np.column_stack([np.arange(len(feasible)), np.zeros((len(feasible), 2))])
    return poses


def test_a_mesh_without_a_model_is_planned(brick, task, plan, tmp_path):
    assert "energy" not in vars(brick) and "lattice" not in vars(brick)
    assert plan.status is Status.SOLVED and plan.num_regrasps >= 1 and plan.residuals().hold
    np.testing.assert_allclose(plan.poses[[0, -1]], [task.start, task.goal], atol=1e-12)
    chain = np.array([exact_energy(brick.feasible_grasps(T)) for T in plan.poses])
    assert plan.cost == pytest.approx(float(sequence_cost(chain, search.CostOptions())), abs=1e-12)
    plan.save(tmp_path / "plan.json")
    assert RegraspPlan.load(tmp_path / "plan.json").residuals().hold


@pytest.mark.parametrize("arm", ["ur5", "panda", "xarm7"])
def test_other_arms_plan_and_move(arm, tmp_path):
    problem = RegraspProblem.load("bottle", write_cell(arm, tmp_path))
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(problem, task.start, task.goal, "exact", seed=0)
    assert plan.status is Status.SOLVED and plan.num_regrasps >= 1 and plan.residuals().hold
    assert not plan_problems(plan, rows=lambda count: range(min(2, count)))
    motion = plan_motion(plan)
    assert motion.status is MotionStatus.SOLVED
    assert not motion_findings(motion, step=0.01, turn=0.1).problems


def test_the_same_seed_gives_the_same_plan(brick, task, plan):
    again = solve_sequence(brick, task.start, task.goal, "exact", seed=3)
    np.testing.assert_array_equal(again.poses, plan.poses)
    other = solve_sequence(brick, task.start, task.goal, "exact", seed=4)
    assert not np.array_equal(other.poses, plan.poses)


def test_ends_that_share_a_grasp_need_no_pose(brick):
    direct = random_task(brick, np.random.default_rng(1), needs_regrasp=False)
    found = solve_sequence(brick, direct.start, direct.goal, "exact")
    assert found.solved and found.num_regrasps == 0 and found.refiner_stats == []


def test_plans_that_are_not_accepted_are_passed_over(brick, task, plan):
    seen = []
    found = solve_sequence(
        brick, task.start, task.goal, "exact", seed=3, accept=lambda p: len(seen) == 2 or seen.append(p)
    )
    assert found.solved and len(seen) == 2
    np.testing.assert_array_equal(seen[0].poses, plan.poses)
    assert len({p.poses.tobytes() for p in (*seen, found)}) == 3


def test_limits_are_kept(brick, task, monkeypatch):
    assert solve_sequence(brick, task.start, task.goal, "exact", max_regrasps=0).status is Status.NOT_FOUND
    assert solve_sequence(brick, task.start, task.goal, "exact", time_limit=1e-9).status is Status.TIME_LIMIT
    with pytest.raises(OptionError, match="max_regrasps is -1"):
        solve_sequence(brick, task.start, task.goal, "exact", max_regrasps=-1)


def test_more_poses_are_drawn_as_long_as_they_may_save_a_regrasp(brick, task, monkeypatch):
    lengths = {128: 3, 512: 2, 1024: 2}
    asked = []

    def paths(self, start, goal, counts):
        asked.append((self.drawn, counts.stop - 1))
        if lengths[self.drawn] in counts:
            chosen = np.arange(lengths[self.drawn])
            everything = np.ones((len(chosen), len(brick.grasps)), dtype=bool)
            yield search.Path(self.numbers[chosen], self.xi[chosen], everything)

    monkeypatch.setattr(RestingPoses, "shortest_paths", paths)
    found = solve_sequence(brick, task.start, task.goal, "exact")
    assert found.num_regrasps == 2 and asked == [(128, 5), (512, 2), (1024, 1)]


@pytest.mark.parametrize("seed", range(6))
def test_paths_are_the_shortest_and_the_widest_first(seed):
    rng = np.random.default_rng(seed)
    feasible = rng.random((25, 40)) < 0.07
    start, goal = (rng.random(40) < 0.05 for _ in range(2))
    poses = poses_with(feasible)
    sets = {**dict(enumerate(feasible)), "start": start, "goal": goal}
    graph = networkx.Graph()
    graph.add_nodes_from(sets)
    for a, b in itertools.combinations(sets, 2):
        width = int((sets[a] & sets[b]).sum())
        if width and {a, b} != {"start", "goal"}:
            graph.add_edge(a, b, width=width)
    found = list(poses.shortest_paths(start, goal, range(1, 11)))
    if not networkx.has_path(graph, "start", "goal"):
        assert found == []
        return
    shortest = list(networkx.all_shortest_paths(graph, "start", "goal"))
    assert {len(path.xi) + 2 for path in found} == {len(shortest[0])}

    def width(path):
        return min(graph.edges[pair]["width"] for pair in itertools.pairwise(path))

    widths = [width(["start", *path.placements.tolist(), "goal"]) for path in found]
    assert widths == sorted(widths, reverse=True)
    assert widths[0] == max(map(width, shortest))
    np.testing.assert_array_equal(found[0].feasible, feasible[found[0].placements])
    assert list(poses.shortest_paths(start, goal, range(1, len(shortest[0]) - 2))) == []


def test_poses_without_a_feasible_grasp_are_not_kept(brick):
    bounds = np.array([[-0.6, 0.1], [0.6, 0.9]])  # beyond reach, and beyond the table
    poses = RestingPoses(brick.checker, PlanarPoses.level(brick.placement_poses, bounds), np.random.default_rng(0))
    poses.grow(40)
    first = poses.xi.copy()
    poses.grow(60)
    assert poses.drawn == 60 and 0 < len(poses.xi) < 60 and poses.feasible.any(axis=1).all()
    np.testing.assert_array_equal(poses.xi[: len(first)], first)
    for number, xi, feasible in zip(poses.numbers[:5], poses.xi, poses.feasible, strict=False):
        np.testing.assert_array_equal(brick.feasible_grasps(brick.pose(int(number), *xi)), feasible)
