"""`RegraspNLP`: its parts, extensions of it, and the same program in CasADi's Opti."""

import casadi as ca
import numpy as np
import pytest
from derivatives import assert_derivative
from scipy.spatial.transform import Rotation

from regrasp_opt.connectivity import CostOptions, SequenceObjective
from regrasp_opt.connectivity.embedding import ProblemEnergy
from regrasp_opt.conventions import planar_transform
from regrasp_opt.errors import OptionError
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.solvers import Candidates, NlpRefiner, ProgramOptions, RegraspNLP

BOUNDS = np.array([[-0.45, 0.1], [0.45, 0.6]])
LIMITS = np.column_stack([BOUNDS, [-np.inf, np.inf]])
GUESS = np.array([[0.1, 0.3, 0.5], [-0.2, 0.4, 2.0]])
PLACEMENTS = [0, 3]
CAMERA = ca.DM([0.2, 0.5])
QUIET = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}


@pytest.fixture
def setting(make_energy):
    """Return a random energy with four placements, and energies (2, G) at both ends."""
    energy, rng = make_energy(grasps=20, hidden=12), np.random.default_rng(3)
    placements = np.tile(np.eye(4), (4, 1, 1))
    placements[:, :3, :3] = Rotation.random(4, rng=rng).as_matrix()
    return ProblemEnergy(energy.model, energy.grasps, PlanarPoses.level(placements, BOUNDS)), rng.uniform(0, 4, (2, 20))


@pytest.fixture
def make_nlp(setting):
    """Return a maker of programs with both ends fixed, or with some of them parameters."""

    def make(**inputs):
        energy, ends = setting
        fixed = {"start": ends[0], "goal": ends[1]}
        values = {"start": ends[0], "goal": ends[1], "mask": np.ones(20)}
        functions = energy.casadi_functions(placements=PLACEMENTS, **{**fixed, **inputs})
        return RegraspNLP(functions, LIMITS, GUESS, {name: values[name] for name in inputs})

    return make


def extend(nlp):
    """Add a slack that bounds the distances to a place, its weight, and a limit on the scores."""
    slack = nlp.variable("slack", 2, lower=0.0, upper=2.0, guess=[0.5, 0.6])
    weight = nlp.parameter("weight", value=3.0)
    nlp.add_cost(weight * ca.sum1(slack))
    away = ca.vertcat(*[ca.sumsqr(nlp.xi[i, :2].T - CAMERA) for i in range(2)])
    nlp.add_constraint("near", away - slack, upper=0.0)
    nlp.add_constraint("pairs", nlp.scores, lower=-50.0, upper=0.0)


def test_the_program_has_the_parts_that_casadi_solves(make_nlp):
    nlp = make_nlp()
    extend(nlp)
    assert nlp.blocks == {
        "x": {"xi": slice(0, 6), "slack": slice(6, 8)},
        "p": {"weight": slice(0, 1)},
        "g": {"near": slice(0, 2), "pairs": slice(2, 5)},
    }
    numbers = nlp.arguments
    np.testing.assert_array_equal(numbers["x0"], [*GUESS.ravel(), 0.5, 0.6])
    np.testing.assert_array_equal(numbers["lbx"], [-0.45, 0.1, -np.inf, -0.45, 0.1, -np.inf, 0.0, 0.0])
    np.testing.assert_array_equal(numbers["ubx"], [0.45, 0.6, np.inf, 0.45, 0.6, np.inf, 2.0, 2.0])
    np.testing.assert_array_equal(numbers["lbg"], [-np.inf, -np.inf, -50.0, -50.0, -50.0])
    np.testing.assert_array_equal(numbers["ubg"], np.zeros(5))
    np.testing.assert_array_equal(numbers["p"], [3.0])
    by_hand = ca.nlpsol("by_hand", "ipopt", nlp.program, QUIET)(**numbers)
    solution = nlp.solve()
    assert solution.converged and solution.violation <= 1e-7
    assert solution.f == pytest.approx(float(by_hand["f"]), abs=1e-4)
    values = nlp.unpack(solution.x)
    assert values["xi"].shape == (2, 3) and values["slack"].shape == (2, 1)
    np.testing.assert_allclose(
        values["slack"][:, 0], ((values["xi"][:, :2] - np.array(CAMERA).ravel()) ** 2).sum(axis=1), atol=1e-4
    )


def test_without_extensions_it_is_the_planners_program(setting, make_nlp):
    energy, ends = setting
    objective = SequenceObjective(energy, energy.placements, *ends, CostOptions())
    start = Candidates(np.array([PLACEMENTS]), GUESS[None], np.zeros(1))
    refined = NlpRefiner().refine(objective, start, np.random.default_rng(0))
    solution = make_nlp().solve()
    assert solution.f == pytest.approx(refined.candidates.cost[0], abs=1e-9)
    assert [solution.iterations] == refined.stats["iterations"]
    assert solution.trace[0] == pytest.approx(objective.cost(start.placements, start.xi)[0], abs=1e-6)


def test_ends_and_mask_may_be_parameters(setting, make_nlp):
    energy, ends = setting
    given = make_nlp(start="input", goal="input", mask="input")
    assert given.blocks["p"] == {"start": slice(0, 20), "goal": slice(20, 40), "mask": slice(40, 60)}
    assert given.solve().f == pytest.approx(make_nlp().solve().f, abs=1e-9)
    given.set_parameter("goal", np.zeros(20))
    functions = energy.casadi_functions(placements=PLACEMENTS, start=ends[0], goal=np.zeros(20))
    assert given.solve().f == pytest.approx(RegraspNLP(functions, LIMITS, GUESS).solve().f, abs=1e-9)


@pytest.mark.parametrize("extended", [False, True])
def test_opti_finds_the_same_optimum(make_nlp, extended):
    nlp = make_nlp(goal="input")
    if extended:
        extend(nlp)
    opti = ca.Opti()
    terms = nlp.add_to_opti(opti)
    opti.minimize(terms.cost)
    opti.solver("ipopt", QUIET)
    found = opti.solve()
    solution = nlp.solve()
    assert found.value(terms.cost) == pytest.approx(solution.f, abs=1e-4)
    poses = [planar_transform(xi) for xi in (found.value(terms.values["xi"]), nlp.unpack(solution.x)["xi"])]
    np.testing.assert_allclose(*poses, atol=1e-3)
    assert found.value(terms.scores).shape == (3,)
    assert set(terms.values) == {"xi", "goal", *(("slack", "weight") if extended else ())}


def test_derivatives_in_an_opti_problem_match_finite_differences(setting):
    """Objective and constraints of a user's own problem mix our functions with their variables."""
    energy, ends = setting
    E, Q_pair, J_seq = energy.casadi_functions(placements=PLACEMENTS, start=ends[0], goal=ends[1])
    opti = ca.Opti()
    xi, u = opti.variable(2, 3), opti.variable(2)
    moved = xi + 0.1 * ca.horzcat(ca.sin(u), ca.cos(u), u**2)
    opti.minimize(J_seq(moved) * (1 + ca.sumsqr(u)) + ca.sumsqr(E(moved)) / 100)
    opti.subject_to(Q_pair(moved) <= u[0])
    lagrangian = opti.f + ca.dot(ca.DM([0.3, 0.0, 2.0]), opti.g)
    hessian, gradient = ca.hessian(lagrangian, opti.x)
    of = ca.Function("of", [opti.x], [lagrangian, ca.densify(gradient), ca.densify(hessian)])
    assert {"jac_J_seq", "jac_jac_J_seq", "jac_jac_Q_pair", "adj1_E", "jac_adj1_E"} <= {
        f.name() for f in of.find_functions()
    }
    v = np.concatenate([GUESS.ravel(), [0.3, -0.4]])
    assert_derivative(lambda x: float(of(x)[0]), np.array(of(v)[1])[:, 0], v)
    assert_derivative(lambda x: np.array(of(x)[1])[:, 0], np.array(of(v)[2]), v)


def test_a_variable_with_equal_bounds_is_fixed(make_nlp):
    nlp = make_nlp()
    held = nlp.variable("held", lower=0.3, upper=0.3, guess=0.3)
    nlp.add_cost((held - 1) ** 2)
    assert nlp.unpack(nlp.solve().x)["held"] == pytest.approx(0.3, abs=1e-7)


def test_an_unreachable_constraint_is_not_hidden(make_nlp):
    nlp = make_nlp()
    nlp.add_constraint("pairs", nlp.scores, upper=-40.0)
    solution = nlp.solve()
    assert not solution.converged and solution.violation > 1.0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda nlp: nlp.variable("xi"), "there is a variable or parameter 'xi' already"),
        (lambda nlp: nlp.variable("a", 2, guess=[1, 2, 3]), r"'a' has shape \(2, 1\), but its numbers have \(3, 1\)"),
        (lambda nlp: nlp.variable("a", lower=np.nan), "'a' is given NaN"),
        (lambda nlp: nlp.variable("a", lower=1, upper=0), "lower bound above its upper"),
        (lambda nlp: nlp.set_parameter("b", 1.0), "there is no parameter 'b'; there are: none"),
        (lambda nlp: (nlp.parameter("c"), nlp.arguments), "parameter 'c' has no value"),
        (lambda nlp: nlp.add_cost(nlp.xi), r"a cost has shape \(2, 3\)"),
        (lambda nlp: [nlp.add_constraint("d", nlp.xi[0, 0], upper=1) for _ in range(2)], "constraint 'd' already"),
        (lambda nlp: (nlp.add_cost(ca.MX.sym("z")), nlp.solve()), "'z' is neither a variable nor a parameter"),
        (lambda nlp: (nlp.add_cost(ca.MX.sym("z")), nlp.add_to_opti(ca.Opti())), "'z' is neither a variable"),
        (lambda nlp: RegraspNLP(nlp.functions, LIMITS, GUESS[:1]), r"guess has shape \(1, 3\); give 2 finite rows"),
    ],
)
def test_wrong_extensions_are_named(make_nlp, wrong, message):
    with pytest.raises(OptionError, match=message):
        wrong(make_nlp())


def test_a_plugin_that_cannot_be_set_up_is_named(make_nlp, monkeypatch):
    monkeypatch.setattr("regrasp_opt.solvers.nlp_solver.plugin_options", lambda settings: {"no_such_option": 1})
    with pytest.raises(OptionError, match="CasADi cannot set up the plugin 'ipopt'"):
        make_nlp().solver(ProgramOptions())
