"""The objective of refiners: poses, ends, what the table rules out, and the grasps that can matter."""

import numpy as np
import pytest

from regrasp_opt.connectivity import BLOCKED, CostOptions, SequenceObjective, TableRule, block, exact_energy
from regrasp_opt.connectivity.costs import pair_score, sequence_cost
from regrasp_opt.conventions import planar_transform, translation
from regrasp_opt.geometry.planar_poses import PlanarPoses

GRASPS = 12
BOUNDS = np.array([[-0.4, 0.1], [0.4, 0.6]])
TABLE = np.array([[-1.0, -1.0], [1.0, 1.0]])


@pytest.fixture
def parts(make_energy):
    rng = np.random.default_rng(5)
    turned = planar_transform([0.0, 0.0, 0.4]) @ translation(0.0, 0.02, 0.05)
    turned[:3, :3] = turned[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    placements = np.array([translation(0.01, 0.0, 0.1), turned])
    start, goal = rng.normal(size=(2, GRASPS))
    numbers = rng.integers(2, size=(3, 4))
    xi = np.concatenate([rng.uniform(*BOUNDS, (3, 4, 2)), rng.uniform(-np.pi, np.pi, (3, 4, 1))], axis=2)
    return make_energy(GRASPS), placements, start, goal, numbers, xi


def objective(parts, rule=None, **options):
    energy, placements, start, goal, *_ = parts
    return SequenceObjective(energy, PlanarPoses.level(placements, BOUNDS), start, goal, CostOptions(**options), rule)


def test_poses_are_planar_motions_of_placements(parts):
    _, placements, _, _, numbers, xi = parts
    poses = objective(parts).poses(numbers, xi)
    assert poses.shape == (3, 4, 4, 4)
    for b, i in np.ndindex(3, 4):
        np.testing.assert_allclose(poses[b, i], planar_transform(xi[b, i]) @ placements[numbers[b, i]], atol=1e-12)


@pytest.mark.parametrize("options", [{}, {"alpha": 0.3, "lambda_reg": 2.0}, {"variant": "J+"}])
def test_the_cost_is_that_of_start_intermediate_poses_and_goal(parts, options):
    energy, placements, start, goal, numbers, xi = parts
    cost = objective(parts, **options).cost(numbers, xi)
    assert cost.shape == (3,) and cost.dtype == np.float64
    for b in range(3):
        middle = energy(planar_transform(xi[b]) @ placements[numbers[b]])
        assert cost[b] == pytest.approx(sequence_cost(np.vstack([start, middle, goal]), CostOptions(**options)))
    single = objective(parts, **options).cost(numbers, xi, np.float32)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, cost, rtol=1e-3, atol=1e-3)


def test_a_chain_begins_with_the_start_and_ends_with_the_goal(parts):
    _, _, start, goal, _, _ = parts
    middle = np.random.default_rng(0).normal(size=(3, 2, GRASPS)).astype(np.float32)
    chain = objective(parts).chain(middle)
    assert chain.shape == (3, 4, GRASPS) and chain.dtype == np.float32
    np.testing.assert_array_equal(chain[:, 1:-1], middle)
    for b in range(3):
        np.testing.assert_array_equal(chain[b, 0], start.astype(np.float32))
        np.testing.assert_array_equal(chain[b, -1], goal.astype(np.float32))
    assert objective(parts).chain(np.zeros((2, 0, GRASPS))).shape == (2, 2, GRASPS)


def test_what_the_table_rules_out_is_blocked_and_nothing_else(parts):
    energy, placements, _, _, numbers, xi = parts
    free = objective(parts)
    np.testing.assert_array_equal(free.ruled_out(numbers, xi), np.zeros((3, 4, GRASPS), dtype=bool))
    point = np.full((2, GRASPS, 2), np.nan)
    point[1, 3] = 0.0, 0.0
    ruled = objective(parts, TableRule(point, TABLE))
    expected = np.zeros((3, 4, GRASPS), dtype=bool)
    expected[numbers == 1, 3] = True
    assert expected.any() and not expected.all()
    np.testing.assert_array_equal(ruled.ruled_out(numbers, xi), expected)
    energies = ruled.energies(numbers, xi)
    np.testing.assert_array_equal(energies[expected], BLOCKED)
    np.testing.assert_array_equal(energies[~expected], free.energies(numbers, xi)[~expected])
    np.testing.assert_allclose(free.energies(numbers, xi), energy(planar_transform(xi) @ placements[numbers]))
    assert (ruled.cost(numbers, xi) != free.cost(numbers, xi)).tolist() == expected.any(axis=(1, 2)).tolist()


def test_the_point_in_the_table_moves_with_the_object():
    point = np.array([[[0.3, 0.1]], [[0.1, -0.3]]])
    rng = np.random.default_rng(1)
    numbers, xi = rng.integers(2, size=200), rng.uniform([-1, -1, -4], [1, 1, 4], (200, 3))
    verdict = TableRule(point, np.array([[-0.5, -0.2], [0.4, 0.6]]))(numbers, xi)
    for number, x, said in zip(numbers, xi, verdict[:, 0], strict=True):
        at = planar_transform(x) @ [*point[number, 0], 0.0, 1.0]
        assert said == (-0.5 < at[0] < 0.4 and -0.2 < at[1] < 0.6)
    assert verdict.any() and not verdict.all()


def test_a_point_on_the_edge_of_the_table_is_free():
    rule = TableRule(np.zeros((1, 1, 2)), np.array([[-0.5, -0.2], [0.4, 0.6]]))
    xi = np.array([[0.4, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.6, 0.0], [0.0, -0.2, 0.0], [0.39, 0.59, 0.0]])
    assert rule(np.zeros(5, dtype=int), xi)[:, 0].tolist() == [False] * 4 + [True]


def test_with_one_regrasp_grasps_that_both_ends_block_do_not_matter(parts):
    energy, placements, _, _, numbers, xi = parts
    start = exact_energy([True, True, False, False] * 3)
    goal = exact_energy([True, False, True, False] * 3)
    whole = SequenceObjective(energy, PlanarPoses.level(placements, BOUNDS), start, goal, CostOptions())
    np.testing.assert_array_equal(whole.useful_grasps(1), [0, 1, 2, 4, 5, 6, 8, 9, 10])
    np.testing.assert_array_equal(whole.useful_grasps(2), np.arange(GRASPS))
    useful = whole.useful_grasps(1)
    chain = whole.chain(whole.energies(numbers[:, :1], xi[:, :1]))
    np.testing.assert_allclose(sequence_cost(chain[..., useful], whole.options), whole.cost(numbers[:, :1], xi[:, :1]))


def test_known_feasibility_is_zero_or_blocked():
    np.testing.assert_array_equal(exact_energy([True, False]), [0.0, BLOCKED])
    np.testing.assert_array_equal(exact_energy(np.array([0, 1])), [BLOCKED, 0.0])
    assert BLOCKED == 30.0
    blocked = block(np.ones(2, np.float32), np.array([True, False]))
    assert blocked.dtype == np.float32 and blocked.tolist() == [BLOCKED, 1.0]
    apart = pair_score(exact_energy([True, False]), exact_energy([False, True]))
    assert apart == pytest.approx(BLOCKED - np.log(2))
