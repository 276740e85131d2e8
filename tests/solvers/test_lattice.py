"""The lattice of poses: where its poses lie, which chains of them are best, and which are worth refining."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import poisson

from regrasp_opt.connectivity import CostOptions, SequenceObjective, sequence_cost
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.solvers import PoseLattice, lattice_starts
from regrasp_opt.solvers.lattice import SPACING, lattice_poses, shared_cost

BOUNDS = np.array([[-0.45, 0.1], [0.45, 0.6]])


@pytest.fixture
def make_objective(make_energy):
    def make(start, goal):
        return SequenceObjective(
            make_energy(len(start)), PlanarPoses.level(np.eye(4)[None], BOUNDS), start, goal, CostOptions()
        )

    return make


def lattice_of(energies, seed=0):
    """Return a lattice whose poses (L) have the given `energies` (L, G), each pose in a cell of its own."""
    count = len(energies)
    xi = np.column_stack([np.arange(count), np.zeros(count), np.zeros(count)])
    return PoseLattice(np.zeros(count, dtype=int), xi, energies.astype(np.float32))


def starts(lattice, objective, num_regrasps=1, count=1):
    return lattice_starts(lattice, objective, num_regrasps, count, np.random.default_rng(0))


def test_the_poses_are_6_cm_and_30_degrees_apart_and_fill_the_workspace():
    numbers, xi = lattice_poses(PlanarPoses.level(np.tile(np.eye(4), (2, 1, 1)), BOUNDS))
    np.testing.assert_array_equal(np.unique(numbers), [0, 1])
    assert len(np.unique(np.column_stack([numbers, np.round(xi, 9)]), axis=0)) == len(xi)
    axes = [np.unique(np.round(xi[:, k], 9)) for k in range(3)]
    assert len(xi) == 2 * np.prod([len(axis) for axis in axes])
    for axis, low, high in zip(axes, *BOUNDS, strict=False):
        np.testing.assert_allclose(np.diff(axis), 0.06)
        assert axis[0] - low == pytest.approx(high - axis[-1]) and 0 <= axis[0] - low < SPACING / 2
    np.testing.assert_allclose(axes[2], np.deg2rad(np.arange(0, 360, 30)))
    narrow = lattice_poses(PlanarPoses.level(np.eye(4)[None], np.array([[0.1, 0.2], [0.1 + 0.9 * SPACING, 0.2]])))[1]
    np.testing.assert_allclose(np.unique(narrow[:, :2], axis=0), [[0.1 + 0.45 * SPACING, 0.2]])


def test_cells_are_squares_of_three_spacings_and_quarter_turns():
    numbers, xi = lattice_poses(PlanarPoses.level(np.tile(np.eye(4), (2, 1, 1)), BOUNDS))
    cells = PoseLattice(numbers, xi, np.zeros((len(xi), 1), np.float32)).cells
    for cell in np.unique(cells)[::7]:
        inside = xi[cells == cell]
        assert len(np.unique(numbers[cells == cell])) == 1
        assert (np.ptp(inside[:, :2], axis=0) < 3 * SPACING).all() and np.ptp(inside[:, 2]) < np.pi / 2
    sizes = np.bincount(cells)
    assert sizes.max() == 3 * 3 * 3 and len(sizes) < len(xi) / 10


def test_the_chance_of_a_shared_grasp_is_that_of_independent_rare_events():
    mass = np.array([1e-6, 0.01, 0.5, 3.0])
    np.testing.assert_allclose(np.exp(-shared_cost(mass)), poisson.sf(0, mass), rtol=1e-6)
    assert np.isfinite(shared_cost(np.zeros(1))).all() and shared_cost(0.0) > 20  # none: costly, but finite


@pytest.mark.parametrize("num_regrasps", [1, 2, 3, 4])
def test_the_first_chain_is_the_likeliest_of_all(num_regrasps, make_objective):
    """By exhaustive search for the chain that maximises the probability that each of its pairs shares a grasp."""
    rng = np.random.default_rng(num_regrasps)
    start, goal = rng.exponential(2.0, (2, 4))
    energies = rng.exponential(3.0, (6, 4))
    found = starts(lattice_of(energies), make_objective(start, goal), num_regrasps)

    def chance(chain):
        steps = itertools.pairwise([start, *energies[list(chain)], goal])
        return np.prod([-np.expm1(-np.exp(-(a + b)).sum()) for a, b in steps])

    best = max(itertools.product(range(6), repeat=num_regrasps), key=chance)
    assert found.xi[0, :, 0].tolist() == list(best)
    expected = sequence_cost(np.vstack([start, energies[list(best)], goal]), CostOptions())
    assert found.cost[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("chance", "kept"), [(0.5, True), (1e-3, True), (1e-4, True), (1e-7, False), (1e-9, False)])
@pytest.mark.parametrize("weak", [0, 1])
def test_chains_are_kept_down_to_a_chance_that_plans_have_had(chance, kept, weak, make_objective):
    """Lattice chains with a pair at 1e-3 have held; where a number of regrasps cannot work, pairs are at 1e-9."""
    ends = np.zeros((2, 1))
    ends[weak] = -np.log(-np.log1p(-chance))
    assert len(starts(lattice_of(np.zeros((3, 1))), make_objective(*ends), count=3)) == (3 if kept else 0)


def test_the_temperature_of_the_cost_ranks_chains_but_leaves_none_out(make_objective):
    lattice = lattice_of(np.array([[0.0, 9.0], [1.0, 1.0]]))
    objective = make_objective(np.zeros(2), np.zeros(2))
    orders = []
    for alpha in (0.2, 5.0):
        found = starts(lattice, replace(objective, options=CostOptions(alpha=alpha)), count=2)
        assert len(found) == 2
        orders.append(found.xi[:, 0, 0].tolist())
    assert orders == [[0.0, 1.0], [1.0, 0.0]]  # one sure grasp counts when cold, two fair ones when hot


def test_start_points_come_from_different_cells_first(make_objective):
    energies, xi = np.array([[0.0], [0.1], [0.2], [0.3]]), np.zeros((4, 3))
    xi[2:, 0] = 10 * SPACING
    lattice = PoseLattice(np.zeros(4, dtype=int), xi, energies.astype(np.float32))
    found = starts(lattice, make_objective(np.zeros(1), np.zeros(1)), count=3)
    np.testing.assert_allclose(found.cost, 2 * np.array([0.0, 0.2, 0.1]), atol=1e-6)


def test_chains_of_equal_cost_keep_their_order(make_objective):
    energies = np.random.default_rng(0).integers(2, size=(200, 1)).astype(float)
    lattice = lattice_of(energies)
    found = starts(replace(lattice, xi=lattice.xi * 10 * SPACING), make_objective(np.zeros(1), np.zeros(1)), count=200)
    order = [*np.flatnonzero(energies == 0), *np.flatnonzero(energies == 1)]
    np.testing.assert_allclose(found.xi[:, 0, 0], np.array(order) * 10 * SPACING)


def test_large_layers_keep_the_cheapest_quarter_and_draw_the_rest_from_what_is_reachable(make_objective, monkeypatch):
    monkeypatch.setattr("regrasp_opt.solvers.lattice.MIDDLE", 8)
    energies = np.full((60, 1), 9.0)  # out of reach: exp(-9) expected grasps
    energies[:30, 0] = np.linspace(0.1, 1.0, 30)
    found = starts(lattice_of(energies), make_objective(np.zeros(1), np.zeros(1)), 2, count=64)
    used = np.unique(found.xi[:, :, 0])
    assert len(found) == 64 and used.max() < 30 and {0.0, 1.0} <= set(used)
    for layer in (0, 1):
        assert len(np.unique(found.xi[:, layer, 0])) == 8
    assert not np.array_equal(np.unique(found.xi[:, 0, 0]), np.arange(8))
