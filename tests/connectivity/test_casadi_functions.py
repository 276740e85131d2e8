"""`E`, `Q_pair` and `J_seq` as CasADi functions: values, derivatives of their own, and the ways to put them to use."""

import ctypes
import itertools
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from derivatives import assert_derivative
from transforms import random_transforms

from regrasp_opt.connectivity import BLOCKED, CostOptions, sequence_cost
from regrasp_opt.connectivity.casadi_chain import cost_of_scores, pair_score
from regrasp_opt.connectivity.casadi_costs import layers_parameter, parametric_functions, plain_sequence_cost
from regrasp_opt.connectivity.embedding import ProblemEnergy
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.errors import OptionError, PoseError
from regrasp_opt.geometry.planar_poses import PlanarPoses


def anywhere(placements):
    """Return `placements` (S, 4, 4) on a level surface without edges."""
    return PlanarPoses.level(placements, [[-np.inf] * 2, [np.inf] * 2])


PLACEMENTS = [0, 3]
OPTIONS = [CostOptions(), CostOptions(alpha=0.4, lambda_reg=2.0), CostOptions(variant="J+")]


@pytest.fixture
def make_problem_energy(make_energy):
    """Return a maker of a random energy with four random placements, energies (G, 2) at both ends, and xi (2, 3)."""

    def make(**keywords):
        energy, rng = make_energy(**keywords), np.random.default_rng(5)
        bound = ProblemEnergy(energy.model, energy.grasps, anywhere(random_transforms(rng, 4)))
        return bound, rng.uniform(0, 4, (len(energy), 2)), rng.normal(size=(2, 3))

    return make


def numpy_cost(energy, options, xi, ends):
    middle = energy(energy.placements.at(PLACEMENTS, xi))
    return float(sequence_cost(np.concatenate([ends[None, :, 0], middle, ends[None, :, 1]]), options))


def plain(energy, variable, ends, options):
    """Return E, Q and J as plainly built expressions of planar parameters (2, 3) or of two poses (8, 4)."""
    expressions = CasadiEnergy(energy.model, len(energy))
    if variable.shape[1] == 3:
        layers = [expressions.layer(layer) for layer in energy.planar_layers(energy.placements[PLACEMENTS])]
        energies = [expressions.planar_expression(layer, variable[i, :].T) for i, layer in enumerate(layers)]
    else:
        energies = [expressions.pose_expression(energy, T) for T in ca.vertsplit(variable, 4)]
    chain = [ends[0], *energies, ends[1]]
    scores = [pair_score(a, b, options) for a, b in itertools.pairwise(chain)]
    return ca.horzcat(*energies).T, ca.vertcat(*scores), cost_of_scores(scores, options.regularisation)


def with_derivatives(expression, variables):
    """Return a function of `variables` to the scalar `expression`, its gradient and its Hessian."""
    gradient = ca.vertcat(*[ca.vec(ca.gradient(expression, v)) for v in variables])
    hessian = ca.horzcat(*[ca.jacobian(gradient, v) for v in variables])
    return ca.Function("f", variables, [expression, ca.densify(gradient), ca.densify(hessian)])


def called(function):
    """Return the names of all functions that `function` calls."""
    return {inner.name() for inner in function.find_functions()}


@pytest.mark.parametrize("over", ["planar", "pose"])
@pytest.mark.parametrize("bounded", [True, False])
@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_derivatives_in_a_larger_graph_are_those_of_plain_expressions(make_problem_energy, over, bounded, options):
    """Every function is wrapped in nonlinear ones, so that gradients and Hessians mix all of their derivatives."""
    energy, ends, xi = make_problem_energy(bounded=bounded)
    start, goal = ca.MX.sym("start", 12), ca.MX.sym("goal", 12)
    if over == "planar":
        variable, numbers = ca.MX.sym("xi", 2, 3), xi
        E, Q_pair, J_seq = energy.casadi_functions(placements=PLACEMENTS, start="input", goal="input", options=options)
    else:
        variable, numbers = ca.MX.sym("T", 8, 4), np.vstack(random_transforms(np.random.default_rng(1), 2))
        E, Q_pair, J_seq = energy.casadi_pose_functions(num_poses=2, start="input", goal="input", options=options)
    variables, numbers = [variable, start, goal], [numbers, *ends.T]
    weights = ca.DM(np.random.default_rng(2).normal(size=(2, 12)))
    plain_E, plain_Q, plain_J = plain(energy, variable, [start, goal], options)
    for name, ours, reference, wrap in (
        ("E", E(variable), plain_E, lambda e: ca.dot(weights, ca.sin(e))),
        ("Q_pair", Q_pair(*variables), plain_Q, lambda q: ca.dot(weights[:3], ca.sin(q))),
        ("J_seq", J_seq(*variables), plain_J, lambda j: ca.exp(j / 10)),
    ):
        fast = with_derivatives(wrap(ours), variables)
        back = "adj1" if name == "E" else "jac"
        assert called(fast) == {name, f"jac_{name}", f"{back}_{name}", f"jac_{back}_{name}"}
        expected = with_derivatives(wrap(reference), variables)(*numbers)
        for a, b in zip(fast(*numbers), expected, strict=True):
            np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-10)


@pytest.mark.parametrize("num_regrasps", [1, 2, 4])
@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_the_planners_functions_have_the_derivatives_of_the_plain_cost(make_energy, num_regrasps, options):
    energy, rng = make_energy(), np.random.default_rng(3)
    expressions = CasadiEnergy(energy.model, len(energy))
    layers = layers_parameter(energy, anywhere(random_transforms(rng, num_regrasps)))
    rest = [layers, *rng.uniform(0, 4, (2, len(energy)))]
    x = ca.MX.sym("xi", num_regrasps, 3)
    ours = parametric_functions(expressions, options, num_regrasps).J_seq
    assert ours.is_diff_in() == [True, False, False, False]
    xi = rng.normal(size=(num_regrasps, 3))
    fast = with_derivatives(ours(x, *rest), [x])
    reference = with_derivatives(plain_sequence_cost(expressions, options, num_regrasps)(x, *rest), [x])
    for a, b in zip(fast(xi), reference(xi), strict=True):
        np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-10)


def test_the_planners_functions_take_blocked_grasps_as_an_input(make_problem_energy):
    energy, ends, xi = make_problem_energy()
    blocked = np.random.default_rng(7).random((2, 12)) < 0.4
    given = energy.casadi_functions(placements=PLACEMENTS, start=ends[:, 0], goal=ends[:, 1], blocked=blocked)
    ours = parametric_functions(CasadiEnergy(energy.model, 12), CostOptions(), 2, blocking=True)
    assert ours.J_seq.name_in() == ["xi", "layers", "blocked", "start", "goal"]
    rest = [layers_parameter(energy, energy.placements[PLACEMENTS]), blocked.T, *ends.T]
    x = ca.MX.sym("xi", 2, 3)
    found = with_derivatives(ours.J_seq(x, *rest) + ca.sumsqr(ours.Q_pair(x, *rest)), [x])
    expected = with_derivatives(given.J_seq(x) + ca.sumsqr(given.Q_pair(x)), [x])
    for a, b in zip(found(xi), expected(xi), strict=True):
        np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-10)


def test_blocks_of_grasps_give_the_same_derivatives(make_energy, monkeypatch):
    energy, rng = make_energy(grasps=23), np.random.default_rng(3)
    rest = [layers_parameter(energy, anywhere(random_transforms(rng, 2))), *rng.uniform(0, 4, (2, 23))]
    x, xi = ca.MX.sym("xi", 2, 3), rng.normal(size=(2, 3))
    found = []
    for block in (256, 5):
        monkeypatch.setattr("regrasp_opt.energy.casadi_blocks.BLOCK", block)
        functions = parametric_functions(CasadiEnergy(energy.model, 23), CostOptions(), 2)
        total = functions.J_seq(x, *rest) + ca.sumsqr(functions.Q_pair(x, *rest))
        found.append(with_derivatives(total, [x])(xi))
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-12)


@pytest.mark.parametrize("activation", ["silu", "tanh"])
def test_derivatives_match_finite_differences(make_problem_energy, activation):
    energy, ends, xi = make_problem_energy(activation=activation)
    E, Q_pair, J_seq = energy.casadi_functions(placements=PLACEMENTS, start=ends[:, 0], goal=ends[:, 1])
    x = ca.MX.sym("xi", 2, 3)
    rows = ca.vertcat(J_seq(x), Q_pair(x), ca.vec(E(x)))
    total = J_seq(x) * Q_pair(x)[1] + ca.sumsqr(E(x))
    jacobian = ca.Function("jacobian", [x], [ca.densify(ca.jacobian(rows, x)), rows])
    both = with_derivatives(total, [x])

    def at(v):
        return v.reshape(3, 2).T

    v = xi.T.ravel()
    assert_derivative(lambda v: np.array(jacobian(at(v))[1])[:, 0], np.array(jacobian(xi)[0]), v)
    assert_derivative(lambda v: float(both(at(v))[0]), np.array(both(xi)[1])[:, 0], v)
    assert_derivative(lambda v: np.array(both(at(v))[1])[:, 0], np.array(both(xi)[2]), v)


def test_poses_from_kinematics_give_the_planar_values(make_problem_energy):
    energy, ends, xi = make_problem_energy()
    arguments = {"start": ends[:, 0], "goal": ends[:, 1]}
    planar = energy.casadi_functions(placements=PLACEMENTS, **arguments)
    full = energy.casadi_pose_functions(num_poses=2, **arguments)
    T = np.vstack(energy.placements.at(PLACEMENTS, xi))
    for a, b in zip(planar, full, strict=True):
        np.testing.assert_allclose(np.array(a(xi)), np.array(b(T)), atol=1e-12)
    np.testing.assert_allclose(np.array(full.E(T)), energy(T.reshape(2, 4, 4)), atol=1e-12)
    assert float(full.J_seq(T)) == pytest.approx(numpy_cost(energy, CostOptions(), xi, ends), abs=1e-12)


def test_names_and_shapes_are_those_of_the_documentation(make_problem_energy):
    energy, ends, _ = make_problem_energy()
    E, Q_pair, J_seq = energy.casadi_functions(placements=PLACEMENTS, start="input", goal="input", mask="input")
    assert (E.name_in(), E.name_out(), E.size_in(0), E.size_out(0)) == (["xi"], ["E"], (2, 3), (2, 12))
    assert (Q_pair.name_in(), Q_pair.name_out()) == (["xi", "start", "goal", "mask"], ["Q"])
    assert (Q_pair.size_in("start"), Q_pair.size_in("mask"), Q_pair.size_out(0)) == ((12, 1), (12, 1), (3, 1))
    assert (J_seq.name_in(), J_seq.name_out(), J_seq.size_out(0)) == (Q_pair.name_in(), ["J"], (1, 1))
    assert J_seq.is_diff_in() == [True, True, True, False]
    _, Q_pair, J_seq = energy.casadi_pose_functions(num_poses=3, start=ends[:, 0])
    assert (J_seq.name_in(), J_seq.size_in(0), Q_pair.size_out(0)) == (["T"], (12, 4), (3, 1))


def test_a_chain_may_lack_either_end_and_needs_no_pair(make_problem_energy):
    energy, ends, xi = make_problem_energy()
    both = energy.casadi_functions(placements=PLACEMENTS, start=ends[:, 0], goal=ends[:, 1])
    open_start = energy.casadi_functions(placements=PLACEMENTS, goal=ends[:, 1])
    neither = energy.casadi_functions(placements=PLACEMENTS)
    scores = np.array(both.Q_pair(xi))
    np.testing.assert_allclose(np.array(open_start.Q_pair(xi)), scores[1:], atol=1e-12)
    np.testing.assert_allclose(np.array(neither.Q_pair(xi)), scores[1:2], atol=1e-12)
    assert float(neither.J_seq(xi)) == pytest.approx(float(scores[1, 0]))
    alone = energy.casadi_functions(placements=[1])
    assert alone.Q_pair(xi[:1]).shape == (0, 1) and float(alone.J_seq(xi[:1])) == 0.0
    x = ca.MX.sym("xi", 1, 3)
    assert np.isfinite(np.array(with_derivatives(ca.sumsqr(alone.E(x)), [x])(xi[:1])[2])).all()


def test_a_chain_without_intermediate_poses_is_one_pair(make_problem_energy):
    energy, ends, _ = make_problem_energy()
    E, Q_pair, J_seq = energy.casadi_functions(placements=[], start=ends[:, 0], goal=ends[:, 1])
    assert E(np.zeros((0, 3))).shape == (0, 12)
    assert float(J_seq(np.zeros((0, 3)))) == pytest.approx(-np.log(np.exp(-ends.sum(axis=1)).sum()))
    assert Q_pair(np.zeros((0, 3))).shape == (1, 1)


@pytest.mark.parametrize("over", ["planar", "pose"])
def test_a_mask_leaves_grasps_out(make_problem_energy, over):
    energy, ends, xi = make_problem_energy()
    mask = np.arange(12) % 3 == 0
    few = ProblemEnergy(energy.model, energy.grasps.subset(np.flatnonzero(mask)), energy.placements)

    def functions(of, ends, mask):
        if over == "planar":
            return of.casadi_functions(placements=PLACEMENTS, start=ends[:, 0], goal=ends[:, 1], mask=mask)
        return of.casadi_pose_functions(num_poses=2, start=ends[:, 0], goal=ends[:, 1], mask=mask)

    x = xi if over == "planar" else np.vstack(energy.placements.at(PLACEMENTS, xi))
    expected = np.array(functions(few, ends[mask], None).Q_pair(x))
    constant, given = functions(energy, ends, mask), functions(energy, ends, "input")
    np.testing.assert_allclose(np.array(constant.Q_pair(x)), expected, atol=1e-12)
    np.testing.assert_allclose(np.array(given.Q_pair(x, mask)), expected, atol=1e-9)
    np.testing.assert_allclose(np.array(given.Q_pair(x, np.zeros(12)) - given.Q_pair(x, np.ones(12))), BLOCKED)
    assert constant.E(x).shape == (2, 12)


@pytest.mark.parametrize("over", ["planar", "pose"])
def test_blocked_grasps_have_a_fixed_energy(make_problem_energy, over):
    energy, ends, xi = make_problem_energy()
    blocked = np.random.default_rng(7).random((2, 12)) < 0.4
    arguments = {"start": ends[:, 0], "goal": ends[:, 1], "blocked": blocked}
    T = np.vstack(energy.placements.at(PLACEMENTS, xi))
    if over == "planar":
        functions, x, numbers = energy.casadi_functions(placements=PLACEMENTS, **arguments), ca.MX.sym("xi", 2, 3), xi
    else:
        functions, x, numbers = energy.casadi_pose_functions(num_poses=2, **arguments), ca.MX.sym("T", 8, 4), T
    learned = plain(energy, x, [ca.DM(ends[:, 0]), ca.DM(ends[:, 1])], CostOptions())[0]
    kept = ca.if_else(ca.DM(blocked.astype(float)), BLOCKED, learned)
    chain = [ca.DM(ends[:, 0]), *ca.horzsplit(kept.T), ca.DM(ends[:, 1])]
    scores = [pair_score(a, b, CostOptions()) for a, b in itertools.pairwise(chain)]
    ours = functions.J_seq(x) + ca.sumsqr(ca.sin(functions.E(x)))
    reference = cost_of_scores(scores, 0.5) + ca.sumsqr(ca.sin(kept))
    for a, b in zip(with_derivatives(ours, [x])(numbers), with_derivatives(reference, [x])(numbers), strict=True):
        np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-10)


def test_a_mask_and_blocked_grasps_leave_out_what_either_does(make_problem_energy):
    energy, ends, xi = make_problem_energy()
    rng = np.random.default_rng(8)
    mask, blocked = rng.random(12) < 0.6, rng.random((2, 12)) < 0.4
    middle = np.where(blocked, BLOCKED, energy(energy.placements.at(PLACEMENTS, xi)))
    chain = np.concatenate([ends[None, :, 0], middle, ends[None, :, 1]])
    arguments = {"placements": PLACEMENTS, "start": ends[:, 0], "goal": ends[:, 1], "blocked": blocked}
    functions = energy.casadi_functions(**arguments, mask=mask)
    assert float(functions.J_seq(xi)) == pytest.approx(sequence_cost(chain[:, mask], CostOptions()), abs=1e-10)
    given = energy.casadi_functions(**arguments, mask="input")
    expected = sequence_cost(chain + BLOCKED * ~mask * [[1], [0], [1], [0]], CostOptions())  # once for each pair
    assert float(given.J_seq(xi, mask)) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("blas", ["classic", "reference"])
def test_functions_are_saved_loaded_and_mapped_with_their_derivatives(make_problem_energy, tmp_path, blas):
    energy, ends, xi = make_problem_energy()
    functions = energy.casadi_functions(placements=PLACEMENTS, start=ends[:, 0], goal=ends[:, 1], blas=blas)
    x, batch = ca.MX.sym("xi", 2, 3), ca.MX.sym("batch", 2, 9)
    for original, name in zip(functions, ("E", "Q_pair", "J_seq"), strict=True):
        original.save(str(tmp_path / name))
        loaded = ca.Function.load(str(tmp_path / name))
        expected = with_derivatives(ca.sumsqr(original(x)), [x])
        found = with_derivatives(ca.sumsqr(loaded(x)), [x])
        if name != "E":
            assert called(found) == {name, f"jac_{name}", f"jac_jac_{name}"}
        for a, b in zip(found(xi), expected(xi), strict=True):
            np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-12)
        mapped = with_derivatives(ca.sumsqr(loaded.map(3)(batch)), [batch])
        parts = [expected(xi + 0.1 * k) for k in range(3)]
        value, gradient, hessian = mapped(np.hstack([xi + 0.1 * k for k in range(3)]))
        assert float(value) == pytest.approx(sum(float(part[0]) for part in parts))
        np.testing.assert_allclose(np.array(gradient), np.array(ca.vertcat(*[part[1] for part in parts])), atol=1e-12)
        np.testing.assert_allclose(np.array(hessian), np.array(ca.diagcat(*[part[2] for part in parts])), atol=1e-12)


@pytest.mark.parametrize("over", ["planar", "pose"])
def test_generated_c_of_values_and_derivatives_needs_no_library(make_problem_energy, tmp_path, monkeypatch, over):
    energy, ends, xi = make_problem_energy()
    arguments = {"start": ends[:, 0], "goal": ends[:, 1], "blas": "reference"}
    if over == "planar":
        x, numbers, functions = ca.MX.sym("xi", 2, 3), xi, energy.casadi_functions(placements=PLACEMENTS, **arguments)
    else:
        x, numbers = ca.MX.sym("T", 8, 4), np.vstack(energy.placements.at(PLACEMENTS, xi))
        functions = energy.casadi_pose_functions(num_poses=2, **arguments)
    function = with_derivatives(functions.J_seq(x), [x])
    monkeypatch.chdir(tmp_path)
    function.generate("f.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", "f.so", "f.c", "-lm"], check=True)
    ctypes.CDLL(str(tmp_path / "f.so"))  # fails on a missing symbol; a call of one would end the process
    compiled = ca.external("f", str(tmp_path / "f.so"))
    for a, b in zip(compiled(numbers), function(numbers), strict=True):
        np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-12)


@pytest.mark.parametrize("blas", ["classic", "reference"])
def test_functions_are_compiled_just_in_time_as_the_page_says(make_problem_energy, tmp_path, monkeypatch, blas):
    energy, ends, xi = make_problem_energy()
    functions = energy.casadi_functions(placements=PLACEMENTS, start=ends[:, 0], goal=ends[:, 1], blas=blas)
    library = Path(ca.__file__).parent / "libcasadi-tp-openblas.so"
    link = {"linker_flags": [str(library), f"-Wl,-rpath,{library.parent}"]} if blas == "classic" else {}
    x = ca.MX.sym("xi", 2, 3)
    expressions = [functions.J_seq(x), ca.gradient(functions.J_seq(x), x)]
    monkeypatch.chdir(tmp_path)
    just_in_time = {"jit": True, "compiler": "shell", "jit_options": {"compiler": "cc", **link}}
    compiled = ca.Function("f", [x], expressions, just_in_time)
    (source,) = [path.read_text() for path in tmp_path.glob("*.c")]
    assert ("dgemm" in source) == (blas == "classic")
    for a, b in zip(compiled(xi), ca.Function("f", [x], expressions)(xi), strict=True):
        np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-12)


def test_extreme_energies_and_alpha_stay_finite(make_problem_energy):
    energy, ends, xi = make_problem_energy()
    x = ca.MX.sym("xi", 2, 3)
    for alpha in (1e-3, 1e3):
        J_seq = energy.casadi_functions(
            placements=PLACEMENTS, start=1e3 * ends[:, 0], goal=1e3 * ends[:, 1], options=CostOptions(alpha=alpha)
        ).J_seq
        assert all(np.isfinite(np.array(part)).all() for part in with_derivatives(J_seq(x), [x])(xi))


@pytest.mark.parametrize("h", [-5.0, 1.5, 100.0])
def test_the_truncated_cost_equals_numpy(make_problem_energy, h):
    energy, ends, xi = make_problem_energy()
    options = CostOptions(variant="Jh", h=h)
    J_seq = energy.casadi_functions(placements=PLACEMENTS, start=ends[:, 0], goal=ends[:, 1], options=options).J_seq
    assert float(J_seq(xi)) == pytest.approx(numpy_cost(energy, options, xi, ends), abs=1e-9)


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"placements": [4]}, OptionError, "placements are .4.; give numbers from 0 to 3"),
        ({"placements": [0.5]}, OptionError, "give numbers from 0 to 3"),
        ({"start": np.zeros(5)}, PoseError, "start pose has shape"),
        ({"goal": np.full(12, np.nan)}, OptionError, "goal energies hold NaN"),
        ({"goal": "output"}, OptionError, "the goal is neither"),
        ({"mask": np.zeros(12, dtype=bool)}, OptionError, "mask leaves no grasp"),
        ({"mask": np.ones(11, dtype=bool)}, OptionError, "neither 12 booleans"),
        ({"mask": np.ones(12)}, OptionError, "neither 12 booleans"),
        ({"blocked": np.zeros((1, 12), dtype=bool)}, OptionError, r"must be a boolean array \(2, 12\)"),
        ({"blas": "fast"}, OptionError, "blas is 'fast'; use one of classic, reference"),
    ],
)
def test_wrong_arguments_are_named(make_problem_energy, wrong, error, message):
    with pytest.raises(error, match=message):
        make_problem_energy()[0].casadi_functions(**{"placements": PLACEMENTS, **wrong})


def test_a_single_pose_may_move(make_problem_energy):
    energy, ends, xi = make_problem_energy()
    options = CostOptions(alpha=0.6)
    full = energy.casadi_pose_functions(num_poses=np.int64(1), start=ends[:, 0], goal=ends[:, 1], options=options)
    T = energy.placements.at(PLACEMENTS[0], xi[0])
    chain = np.vstack([ends[:, 0], energy(T), ends[:, 1]])
    assert full.J_seq.size_in(0) == (4, 4)
    assert float(full.J_seq(T)) == pytest.approx(float(sequence_cost(chain, options)), abs=1e-12)


@pytest.mark.parametrize("count", [0, 1.5, True])
def test_the_number_of_poses_is_checked(make_problem_energy, count):
    with pytest.raises(OptionError, match="num_poses is"):
        make_problem_energy()[0].casadi_pose_functions(num_poses=count)
