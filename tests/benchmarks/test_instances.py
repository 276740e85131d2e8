import numpy as np
import pytest

from regrasp_opt.benchmarks.harness.instances import PosePool, choose_instances, instances_hash, planar_parameters
from regrasp_opt.benchmarks.harness.oracle import Oracle
from regrasp_opt.conventions import planar_transform


@pytest.fixture(scope="module")
def pool(bottle_problem):
    return PosePool.draw(bottle_problem, 0, 40)


@pytest.fixture(scope="module")
def oracle(pool):
    """Return an oracle whose grid is every second pose of the pool."""
    feasible = pool.feasible[::2]
    return Oracle(np.zeros(len(feasible), dtype=np.int64), np.zeros((len(feasible), 3)), feasible, 0.0)


def test_pool_poses_are_labelled_exactly(bottle_problem, pool):
    assert pool.feasible.any(axis=1).all()
    np.testing.assert_array_equal(pool.feasible[3], bottle_problem.feasible_grasps(pool.T[3]))


def test_the_same_seed_gives_the_same_pool(bottle_problem, pool):
    again = PosePool.draw(bottle_problem, 0, 40)
    np.testing.assert_array_equal(again.T, pool.T)
    assert not np.array_equal(PosePool.draw(bottle_problem, 1, 40).T[0], pool.T[0])


def test_poses_without_a_grasp_leave_the_pool(pool):
    ids = np.array([0])
    few = pool.with_grasps(ids)
    assert len(few.T) == pool.feasible[:, 0].sum() and few.feasible.shape == (len(few.T), 1)


def test_instances_have_the_tier_that_was_asked_for(bottle_problem, pool, oracle):
    for tier, allowed in (("0", {0}), ("1", {1}), ("any", {1, 2, 3, None})):
        chosen = choose_instances(pool, oracle, {tier: 4}, np.random.default_rng(0), "bottle")
        assert chosen
        for instance in chosen:
            ends = np.array([bottle_problem.feasible_grasps(T) for T in instance.ends])
            assert (np.inf if instance.minimum is None else instance.minimum) == oracle.minimum_table(ends)[0, 1]
            assert instance.minimum in allowed


def test_names_differ_and_the_hash_freezes_them(pool, oracle):
    first = choose_instances(pool, oracle, {"0": 3, "1": 3}, np.random.default_rng(0), "bottle")
    same = choose_instances(pool, oracle, {"0": 3, "1": 3}, np.random.default_rng(0), "bottle")
    other = choose_instances(pool, oracle, {"0": 3, "1": 3}, np.random.default_rng(1), "bottle")
    assert len({instance.name for instance in first}) == 6
    assert instances_hash(first) == instances_hash(same) != instances_hash(other)


def test_planar_parameters_invert_the_placing(bottle_problem):
    rng = np.random.default_rng(5)
    for number in range(len(bottle_problem.placements)):
        xi = np.array([*rng.uniform(-0.4, 0.4, 2), rng.uniform(-3, 3)])
        T = planar_transform(xi) @ bottle_problem.placement_poses[number]
        found, back = planar_parameters(T, bottle_problem.placement_poses)
        assert found == number
        np.testing.assert_allclose(back, xi, atol=1e-12)
