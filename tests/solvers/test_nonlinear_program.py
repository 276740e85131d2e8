"""The one builder of nonlinear programs: order of the numbers, names of rows, and what a solution says."""

import casadi as ca
import numpy as np
import pytest

from regrasp_opt.solvers.nonlinear_program import NonlinearProgram


@pytest.fixture(params=[ca.MX, ca.SX])
def program(request):
    """Return a program with a matrix, a vector, a parameter and two constraints; its minimum is at the bounds."""
    program = NonlinearProgram(request.param)
    a = program.variable("a", (2, 3), lower=[[0, 1, 2], [3, 4, 5]], upper=9.0, guess=np.arange(6).reshape(2, 3) + 0.5)
    b = program.variable("b", 2, lower=-1.0, upper=1.0, guess=[0.1, 0.2])
    p = program.parameter("p", (2, 2), [[1.0, 2.0], [3.0, 4.0]])
    program.add_cost(ca.sumsqr(a) + ca.sumsqr(b - 0.5))
    program.add_constraint("sum", ca.sum1(b), upper=0.6, unit=" m", scale=0.1)
    program.add_constraint("rows", a[:, :2] + p, lower=0.0, labels=["top left", "top right", "low left", "low right"])
    return program


def test_variables_and_constraints_stand_row_by_row_and_parameters_column_by_column(program):
    numbers = program.arguments
    np.testing.assert_array_equal(numbers["x0"], [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 0.1, 0.2])
    np.testing.assert_array_equal(numbers["lbx"], [0, 1, 2, 3, 4, 5, -1, -1])
    np.testing.assert_array_equal(numbers["p"], [1.0, 3.0, 2.0, 4.0])
    evaluate = ca.Function("g", [program.x, program.p], [program.g])
    g = np.array(evaluate(numbers["x0"], numbers["p"])).ravel()
    np.testing.assert_allclose(g, [0.3, 1.5, 3.5, 6.5, 8.5])
    assert program.blocks["g"] == {"sum": slice(0, 1), "rows": slice(1, 5)}


def test_the_solution_is_unpacked_in_the_shapes_of_the_variables(program):
    solution = program.solve()
    found = program.unpack(solution.x)
    np.testing.assert_allclose(found["a"], [[0, 1, 2], [3, 4, 5]], atol=5e-3)
    np.testing.assert_allclose(found["b"], [[0.3], [0.3]], atol=1e-3)
    assert solution.converged and solution.f == pytest.approx(55 + 2 * 0.2**2, abs=1e-3)
    assert program.worst_violation(solution.g, 1e-5) == ""


def test_the_worst_row_is_named_with_its_size_and_unit(program):
    assert program.worst_violation([0.9, 1, 1, 1, 1], 0.1) == "sum is violated by 0.03 m"
    assert program.worst_violation([0.9, 1, 1, -0.5, 1], 0.1) == "low left is violated by 0.5"
    assert program.worst_violation([0.9, 1, 1, -0.2, 1], 0.31) == ""
    assert program.worst_violation([0.9, np.nan, 1, 1, 1], 10.0) == "the solver left numbers that are not finite"
    assert NonlinearProgram().worst_violation([], 0.0) == ""


@pytest.mark.parametrize("broken", ["x", "g"])
def test_numbers_that_are_not_finite_violate_without_bound(program, monkeypatch, broken):
    solver = program.solver()
    found = {name: ca.DM(value) for name, value in solver.casadi_solver(**program.arguments).items()}
    found[broken] = ca.DM.nan(*found[broken].shape)
    stats = solver.casadi_solver.stats()

    class Stub:
        def __call__(self, **_):
            return found

        def stats(self):
            return stats

    solver.casadi_solver = Stub()
    assert solver.solve(program.arguments["x0"], p=program.arguments["p"]).violation == np.inf


def test_a_solver_keeps_to_the_constraints_whatever_start_and_bounds_it_is_given(program):
    program.add_constraint("corner", program.x[5], lower=6.5)
    solution = program.solver().solve(program.arguments["x0"], p=program.arguments["p"], lbx=-1.0, ubx=9.0)
    found = program.unpack(solution.x)
    assert solution.converged and found["a"][1, 2] == pytest.approx(6.5, abs=1e-4)
    assert found["b"].sum() == pytest.approx(0.6, abs=1e-3)
    free = program.solver().solve(program.arguments["x0"], p=program.arguments["p"], lbx=-1.0, lbg=-np.inf)
    assert program.unpack(free.x)["a"][1, 2] == pytest.approx(-0.0, abs=1e-2)
