"""Every refiner against reference problems with known minima, and the promises of the protocol."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt.connectivity import BLOCKED, CostOptions, SequenceObjective, TableRule, exact_energy, pair_score
from regrasp_opt.energy.features import feature_count
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.grasps import GraspSet
from regrasp_opt.solvers import (
    Candidates,
    LangevinRefiner,
    LatticeRefiner,
    NlpRefiner,
    NlpSolver,
    PoseLattice,
    ProgramOptions,
    RecordingRefiner,
    lattice_starts,
    random_starts,
)
from regrasp_opt.solvers.landscape import NumPyLandscape, TorchLandscape

BOUNDS = np.array([[-0.45, 0.1], [0.45, 0.6]])
TARGET = np.array([0.1, 0.3])
REFINERS = [
    NlpRefiner(),
    NlpRefiner(ProgramOptions(hessian="limited-memory")),
    NlpRefiner(ProgramOptions(plugin="sqpmethod")),
    LangevinRefiner(device="cpu"),
    LatticeRefiner(),
]


def bowl_objective() -> SequenceObjective:
    """Return an objective whose one-regrasp minimum is at TARGET: E = c + logcosh-like walls around it.

    Each coordinate has two hidden tanh units that saturate on either side, so that E rises with distance.
    """
    hidden, inputs = 4, feature_count("paper", False)
    W1, b1 = np.zeros((hidden, inputs)), np.zeros(hidden)
    for k in range(2):
        W1[2 * k, 4 * k + 3], b1[2 * k] = 8.0, -8.0 * TARGET[k] - 1.0
        W1[2 * k + 1, 4 * k + 3], b1[2 * k + 1] = -8.0, 8.0 * TARGET[k] - 1.0
    W2, b2 = np.eye(hidden), np.zeros(hidden)
    W3, b3 = np.full((1, hidden), 3.0), np.zeros(1)
    arrays = [[a.astype(np.float32) for a in part] for part in ([W1, W2, W3], [b1, b2, b3])]
    model = EnergyModel(tuple(arrays[0]), tuple(arrays[1]), "tanh", "paper", False, True, 1.0)
    grasps = GraspSet(np.tile(np.eye(4), (3, 1, 1)), np.zeros(3), "parallel")
    ends = exact_energy(np.ones(3, dtype=bool))
    return SequenceObjective(
        GraspEnergy(model, grasps), PlanarPoses.level(np.eye(4)[None], BOUNDS), ends, ends, CostOptions()
    )


@pytest.fixture
def random_objective(make_energy):
    energy = make_energy(grasps=20, hidden=12)
    rng = np.random.default_rng(3)
    placements = np.tile(np.eye(4), (3, 1, 1))
    placements[1, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    placements[2, :3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    ends = [exact_energy(rng.random(20) < 0.3) for _ in range(2)]
    return SequenceObjective(energy, PlanarPoses.level(placements, BOUNDS), *ends, CostOptions())


@pytest.mark.parametrize("refiner", REFINERS[:3], ids=lambda r: r.name)
def test_solvers_find_the_known_minimum(refiner):
    objective = bowl_objective()
    starts = random_starts(objective, 1, 6, np.random.default_rng(0))
    refined = refiner.refine(objective, starts, np.random.default_rng(0))
    np.testing.assert_allclose(refined.candidates.xi[:, 0, :2], np.tile(TARGET, (6, 1)), atol=2e-3)
    assert refined.stats["converged"] == refined.stats["solves"] == 6


def test_langevin_moves_towards_the_known_minimum():
    objective = bowl_objective()
    starts = random_starts(objective, 1, 50, np.random.default_rng(0))
    refined = LangevinRefiner(iterations=40, tau=0.001, device="cpu").refine(
        objective, starts, np.random.default_rng(0)
    )
    before = np.linalg.norm(starts.xi[:, 0, :2] - TARGET, axis=1).mean()
    after = np.linalg.norm(refined.candidates.xi[:, 0, :2] - TARGET, axis=1).mean()
    assert after < 0.5 * before


@pytest.mark.parametrize("refiner", REFINERS, ids=lambda r: r.name)
@pytest.mark.parametrize("num_regrasps", [1, 3])
def test_the_protocol_is_kept(refiner, num_regrasps, random_objective):
    starts = random_starts(random_objective, num_regrasps, 7, np.random.default_rng(1))
    refined = refiner.refine(random_objective, starts, np.random.default_rng(2)).candidates
    again = refiner.refine(random_objective, starts, np.random.default_rng(2)).candidates
    assert refined.xi.shape == starts.xi.shape and (refined.placements == starts.placements).all()
    assert (refined.cost <= starts.cost + 1e-4).all()
    np.testing.assert_allclose(refined.cost, random_objective.cost(refined.placements, refined.xi), atol=1e-4)
    low, high = BOUNDS
    assert (refined.xi[..., :2] >= low - 1e-9).all() and (refined.xi[..., :2] <= high + 1e-9).all()
    np.testing.assert_array_equal(refined.xi, again.xi)


@pytest.mark.parametrize("device", ["cpu", "numpy"])
def test_langevin_gradient_is_that_of_the_objective(random_objective, device):
    """One noiseless step is the gradient step on workspace-scaled parameters (Eq. 7)."""
    starts = random_starts(random_objective, 2, 4, np.random.default_rng(1))
    eta = 1e-3
    moved = LangevinRefiner(1, eta=eta, tau=0.0, keep_best=False, device=device).refine(
        random_objective, starts, np.random.default_rng(0)
    )
    scale = np.array([0.45, 0.25, np.pi])
    for b in range(len(starts)):
        gradient = np.zeros((2, 3))
        for i in range(2):
            for k in range(3):
                shift = np.zeros((1, 2, 3))
                shift[0, i, k] = 1e-5
                costs = [
                    random_objective.cost(starts.placements[b : b + 1], starts.xi[b : b + 1] + sign * shift)[0]
                    for sign in (1, -1)
                ]
                gradient[i, k] = (costs[0] - costs[1]) / 2e-5
        step = moved.candidates.xi[b] - starts.xi[b]
        np.testing.assert_allclose(step, -eta * scale**2 * gradient, atol=2e-5)


def test_lattice_starts_are_chains_of_lattice_poses_with_their_true_cost(random_objective):
    lattice = PoseLattice.build(random_objective.energy, random_objective.placements)
    known = {(int(p), *np.round(x, 9)) for p, x in zip(lattice.placements, lattice.xi, strict=True)}
    for num_regrasps in (1, 2, 3):
        chains = lattice_starts(lattice, random_objective, num_regrasps, 12, np.random.default_rng(0))
        assert chains.xi.shape == (12, num_regrasps, 3)
        for placements, xi in zip(chains.placements, chains.xi, strict=True):
            assert all((int(p), *np.round(x, 9)) in known for p, x in zip(placements, xi, strict=True))
        np.testing.assert_allclose(chains.cost, random_objective.cost(chains.placements, chains.xi), atol=1e-4)
        assert len({tuple(map(tuple, np.round(xi, 6))) for xi in chains.xi}) == 12


def test_one_step_lattice_start_is_the_best_of_the_lattice(random_objective):
    """With J+ and probabilities far from one the ranking by success is that of an exhaustive search."""
    lattice = PoseLattice.build(random_objective.energy, random_objective.placements)
    best = lattice_starts(lattice, random_objective, 1, 1, np.random.default_rng(0))
    P = np.exp(-lattice.energies.astype(float))
    masses = [P @ np.exp(-end) for end in (random_objective.start_energy, random_objective.goal_energy)]
    probability = np.prod([1 - np.exp(-m) for m in masses], axis=0)
    index = int(probability.argmax())
    assert best.placements[0, 0] == lattice.placements[index]
    np.testing.assert_allclose(best.xi[0, 0], lattice.xi[index])


def test_lattice_starts_leave_out_what_has_no_chance(random_objective, monkeypatch):
    lattice = PoseLattice.build(random_objective.energy, random_objective.placements)

    def starts(objective):
        return lattice_starts(lattice, objective, 1, len(lattice.xi), np.random.default_rng(0))

    P = np.exp(-lattice.energies.astype(float))
    masses = [P @ np.exp(-end) for end in (random_objective.start_energy, random_objective.goal_energy)]
    probability = np.min([1 - np.exp(-m) for m in masses], axis=0)
    limit = float(np.median(probability))
    monkeypatch.setattr("regrasp_opt.solvers.lattice.LEAST_CHANCE", limit)
    assert abs(len(starts(random_objective)) - (probability > limit).sum()) <= 1  # single against double precision
    cold = replace(random_objective, options=CostOptions(alpha=1e-3))  # a chance does not depend on the cost's options
    assert len(starts(cold)) > 0
    blocked = replace(random_objective, goal_energy=np.full_like(random_objective.goal_energy, BLOCKED))
    assert len(starts(blocked)) == 0


def test_candidates_rank_by_cost():
    batch = Candidates(np.zeros((3, 1), dtype=int), np.arange(9.0).reshape(3, 1, 3), np.array([2.0, 1.0, 3.0]))
    assert batch.best(2).cost.tolist() == [1.0, 2.0]
    assert batch.best(2).xi[0, 0, 0] == 3.0


@pytest.mark.parametrize("wrong", [{"max_iterations": 0}, {"tolerance": 0.0}, {"plugin": "nothing"}])
def test_wrong_solver_options_are_rejected(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        ProgramOptions(**wrong)


def test_nlp_and_lattice_run_without_torch():
    script = (
        "import sys; sys.path.insert(0, 'tests'); sys.path.insert(0, 'tests/solvers');"
        "from test_refiners import bowl_objective, np;"
        "from regrasp_opt.solvers import NlpRefiner, LatticeRefiner, random_starts;"
        "o = bowl_objective(); r = np.random.default_rng(0); s = random_starts(o, 1, 2, r);"
        "NlpRefiner().refine(o, s, r); LatticeRefiner().refine(o, s, r);"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


@pytest.mark.parametrize("plugin", ["ipopt", "sqpmethod"])
def test_pair_limit_is_kept_or_the_start_is_returned(plugin, random_objective):
    starts = random_starts(random_objective, 2, 6, np.random.default_rng(4))

    def scores(candidates):
        middle = random_objective.energy(random_objective.poses(candidates.placements, candidates.xi))
        chain = random_objective.chain(middle)
        return pair_score(chain[:, :-1], chain[:, 1:])

    free = NlpRefiner(ProgramOptions(plugin=plugin)).refine(random_objective, starts, np.random.default_rng(0))
    limit = float(scores(free.candidates).max(axis=1).mean())
    options = ProgramOptions(plugin=plugin, pair_limit=limit)
    refined = NlpRefiner(options).refine(random_objective, starts, np.random.default_rng(0))
    kept = (scores(refined.candidates) <= limit + 1e-5).all(axis=1)
    unchanged = np.isclose(refined.candidates.xi, starts.xi, atol=1e-12).all(axis=(1, 2))
    assert (kept | unchanged).all() and kept.any()


def test_grasps_that_cannot_matter_are_left_out_without_a_change_of_the_cost(random_objective):
    """Five of twenty grasps are feasible at an end: with one regrasp eight are enough, with two all are in."""
    feasible = np.arange(20)[:, None] < [3, 0]
    feasible[10:12, 1] = True
    objective = replace(
        random_objective, start_energy=exact_energy(feasible[:, 0]), goal_energy=exact_energy(feasible[:, 1])
    )
    for num_regrasps, grasps in ((1, 8), (2, 20)):
        starts = random_starts(objective, num_regrasps, 3, np.random.default_rng(0))
        refined = NlpRefiner().refine(objective, starts, np.random.default_rng(0))
        assert refined.stats["grasps"] == grasps and refined.stats["solves"] == 3
        assert sorted(refined.stats["statuses"].items()) == [
            (s, refined.status.count(s)) for s in sorted({*refined.status})
        ]
        for trace, xi, placements in zip(refined.traces, refined.candidates.xi, starts.placements, strict=True):
            assert trace[-1] == pytest.approx(objective.cost(placements[None], xi[None])[0], abs=1e-6)


def test_each_candidate_has_a_status_and_a_trace(random_objective):
    starts = random_starts(random_objective, 1, 3, np.random.default_rng(4))
    for refiner in REFINERS:
        refined = refiner.refine(random_objective, starts, np.random.default_rng(0))
        assert len(refined.status) == len(refined.traces) == 3
        for trace, cost in zip(refined.traces, starts.cost, strict=True):
            assert trace[0] == pytest.approx(cost, abs=1e-4)


def landscapes(objective, num_regrasps):
    """Return the landscape of `objective` in torch and in NumPy."""
    import torch

    return [TorchLandscape(objective, num_regrasps, torch.device("cpu")), NumPyLandscape(objective, num_regrasps)]


@pytest.mark.parametrize("num_regrasps", [1, 2, 3])
def test_langevin_descends_the_objective_with_what_the_table_rules_out(random_objective, num_regrasps):
    rng = np.random.default_rng(8)
    point = rng.uniform(-0.2, 0.2, (3, 20, 2))
    point[rng.random((3, 20)) < 0.5] = np.nan
    objective = replace(random_objective, rule=TableRule(point, np.array([[-0.3, -0.3], [0.3, 0.3]])))
    placements = rng.integers(3, size=(30, num_regrasps))
    xi = rng.uniform([-0.4, -0.4, -3.0], [0.4, 0.4, 3.0], (30, num_regrasps, 3))
    assert 0.05 < objective.ruled_out(placements, xi).mean() < 0.6
    gradients = []
    for landscape in landscapes(objective, num_regrasps):
        cost, gradient = landscape(placements, xi, objective.ruled_out(placements, xi))
        np.testing.assert_allclose(cost, objective.cost(placements, xi), rtol=2e-4, atol=2e-4)
        assert not np.allclose(cost, random_objective.cost(placements, xi), atol=1e-2)
        gradients.append(gradient)
    np.testing.assert_allclose(*gradients, rtol=2e-3, atol=2e-3 * np.abs(gradients[0]).max())


@pytest.mark.parametrize("activation", ["silu", "selu", "tanh"])
@pytest.mark.parametrize(("bounded", "variant", "alpha"), [(True, "J", 1.0), (False, "J+", 0.7), (True, "J", 2.0)])
def test_gradients_in_numpy_are_those_of_torch(random_objective, activation, bounded, variant, alpha):
    energy = random_objective.energy
    model = replace(energy.model, activation=activation, bounded=bounded)
    options = CostOptions(alpha=alpha, variant=variant)
    objective = replace(random_objective, energy=GraspEnergy(model, energy.grasps), options=options)
    starts = random_starts(objective, 3, 20, np.random.default_rng(3))
    nothing = np.zeros((20, 3, len(energy)), dtype=bool)
    (cost, gradient), (same, other) = (f(starts.placements, starts.xi, nothing) for f in landscapes(objective, 3))
    np.testing.assert_allclose(cost, same, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(gradient, other, rtol=5e-3, atol=2e-3 * np.abs(gradient).max())


@pytest.mark.parametrize("refiner", REFINERS, ids=lambda r: r.name)
def test_recording_keeps_each_iteration_and_changes_nothing(refiner, random_objective):
    starts = random_starts(random_objective, 2, 3, np.random.default_rng(1))
    plain = refiner.refine(random_objective, starts, np.random.default_rng(2))
    recorder = RecordingRefiner(refiner)
    recorded = recorder.refine(random_objective, starts, np.random.default_rng(2))
    assert recorder.name == refiner.name and plain.paths == ()
    np.testing.assert_array_equal(recorded.candidates.xi, plain.candidates.xi)
    [batch] = recorder.batches
    assert batch.starts is starts and batch.refinement is recorded
    if isinstance(refiner, LatticeRefiner):
        assert recorded.paths == ()
        return
    for number, (path, trace) in enumerate(zip(recorded.paths, recorded.traces, strict=True)):
        assert path.shape == (len(path), 2, 3) and len(path) > 2
        np.testing.assert_allclose(path[0], starts.xi[number], atol=1e-6)
        if isinstance(refiner, NlpRefiner) and refiner.program.plugin != "ipopt":
            continue  # it keeps no costs by iteration
        placements = np.tile(starts.placements[number], (len(path), 1))
        np.testing.assert_allclose(random_objective.cost(placements, path), trace, atol=2e-3)


def test_a_solver_records_the_variables_of_each_iteration():
    import casadi as ca

    x, g = ca.MX.sym("x", 2), ca.MX.sym("p")
    program = {"x": x, "p": g, "f": (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2, "g": x[0] + g}
    solver = NlpSolver(program, ProgramOptions(record=True))
    for start in ([-1.0, 1.0], [0.5, 0.0]):
        found = solver.solve(start, p=[0.0], lbg=-3.0, ubg=3.0)
        assert len(found.path) == found.iterations + 1 == len(found.trace)
        np.testing.assert_array_equal(found.path[0], start)
        np.testing.assert_allclose(found.path[-1], [1.0, 1.0], atol=1e-4)
        np.testing.assert_allclose(
            (1 - found.path[:, 0]) ** 2 + 100 * (found.path[:, 1] - found.path[:, 0] ** 2) ** 2, found.trace, atol=1e-9
        )
    assert len(NlpSolver(program, ProgramOptions()).solve([-1.0, 1.0], p=[0.0]).path) == 0
