"""The search for intermediate poses as a nonlinear program that can be extended before it is solved.

minimise    J_seq(xi) + own costs                       (Eq. 5)
subject to  low <= (x_i, y_i) <= high                   for each intermediate pose
            own constraints

``xi`` (3, N) is the first block of the variables ``x``. Own variables, parameters, costs and constraints are CasADi
expressions; the functions behind ``J_seq`` bring their derivatives along (`regrasp_opt.energy.casadi_function`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.connectivity.casadi_costs import ConnectivityFunctions
from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.nlp_solver import NlpSolution, NlpSolver
from regrasp_opt.solvers.options import ProgramOptions
from regrasp_opt.threads import one_blas_thread


@dataclass(frozen=True, eq=False)
class _Block:
    """An expression with the numbers that go with it, each of its shape: bounds and guess, or a parameter's value."""

    expression: Any
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    value: FloatArray | None = None


class OptiTerms(NamedTuple):
    """What `RegraspNLP.add_to_opti` has put into an Opti problem, as that problem's expressions.

    ``values`` holds the variables and parameters by name, ``xi`` among them; ``cost`` is to be minimised, together with
    whatever else; ``scores`` (N+1, 1) are the pair scores.
    """

    values: dict[str, Any]
    cost: Any
    scores: Any


class RegraspNLP:
    """The program ``{x, p, f, g}`` over the planar parameters of N intermediate poses; see the module docstring.

    Parameters
    ----------
    functions : ConnectivityFunctions
        Of ``xi`` (3, N) and any further inputs, which become parameters.
    bounds : (2, 2)
        Corners ``[[x_low, y_low], [x_high, y_high]]`` of the workspace [m].
    guess : (N, 3)
        Planar parameters [m, m, rad] to start from.
    values : mapping, optional
        Values of the functions' further inputs by name.

    Attributes
    ----------
    functions : ConnectivityFunctions
    xi : casadi.MX (3, N)
        Planar parameters of the intermediate poses.
    cost : casadi.MX
        ``J_seq`` without own costs.
    f : casadi.MX
        What is minimised.
    """

    def __init__(
        self,
        functions: ConnectivityFunctions,
        bounds: FloatArray,
        guess: ArrayLike,
        values: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        J_seq = functions.J_seq
        count = J_seq.size2_in(0)
        start = np.asarray(guess, dtype=np.float64)
        if start.shape != (count, 3) or not np.isfinite(start).all():
            raise OptionError(f"the guess has shape {start.shape}; give {count} finite rows (x, y, theta)")
        self.functions = functions
        self._variables: dict[str, _Block] = {}
        self._parameters: dict[str, _Block] = {}
        self._rows: dict[str, _Block] = {}
        low, high = (np.append(side, free)[:, None] for side, free in zip(bounds, (-np.inf, np.inf), strict=True))
        self.xi = self.variable("xi", (3, count), lower=low, upper=high, guess=start.T)
        given = dict(values or {})
        self._inputs = [
            self.parameter(J_seq.name_in(i), J_seq.size_in(i), given.get(J_seq.name_in(i)))
            for i in range(1, J_seq.n_in())
        ]
        self.cost = J_seq(self.xi, *self._inputs)
        self.f = self.cost

    @cached_property
    def scores(self) -> Any:
        """``Q_pair`` (N+1, 1) of neighbouring poses."""
        return self.functions.Q_pair(self.xi, *self._inputs)

    def variable(
        self,
        name: str,
        shape: int | tuple[int, int] = 1,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        guess: ArrayLike = 0.0,
    ) -> Any:
        """Add a variable within bounds and return its symbol.

        Parameters
        ----------
        name : str
        shape : int or (int, int)
        lower, upper : array_like
            Its bounds, one for all entries or one for each.
        guess : array_like
            Where a solver starts.

        Returns
        -------
        casadi.MX

        Raises
        ------
        OptionError
            If the name is taken, a bound or the guess does not fit the shape, or a lower bound is above its upper one.
        """
        symbol = self._symbol(name, shape)
        low, high, start = (_filled(part, symbol, name) for part in (lower, upper, guess))
        if (low > high).any():
            raise OptionError(f"variable '{name}' has a lower bound above its upper bound")
        self._variables[name] = _Block(symbol, low, high, start)
        return symbol

    def parameter(self, name: str, shape: int | tuple[int, int] = 1, value: ArrayLike | None = None) -> Any:
        """Add a parameter and return its symbol.

        Parameters
        ----------
        name : str
        shape : int or (int, int)
        value : array_like, optional
            It may be set later, with `set_parameter`.

        Returns
        -------
        casadi.MX

        Raises
        ------
        OptionError
            If the name is taken, or the value does not fit the shape.
        """
        symbol = self._symbol(name, shape)
        self._parameters[name] = _Block(symbol)
        if value is not None:
            self.set_parameter(name, value)
        return symbol

    def set_parameter(self, name: str, value: ArrayLike) -> None:
        """Set the value of the parameter `name` to `value`, which has its shape or is one number for all entries.

        Raises
        ------
        OptionError
            If there is no such parameter, or the value does not fit its shape.
        """
        if name not in self._parameters:
            raise OptionError(f"there is no parameter '{name}'; there are: {', '.join(self._parameters) or 'none'}")
        symbol = self._parameters[name].expression
        self._parameters[name] = _Block(symbol, value=_filled(value, symbol, name))

    def add_cost(self, term: Any) -> None:
        """Add the scalar expression `term` to what is minimised.

        Raises
        ------
        OptionError
            If it is no scalar.
        """
        if ca.MX(term).shape != (1, 1):
            raise OptionError(f"a cost has shape {ca.MX(term).shape}; give a scalar expression")
        self.f = self.f + term

    def add_constraint(
        self, name: str, expression: Any, *, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf
    ) -> None:
        """Demand ``lower <= expression <= upper``, elementwise; equal bounds make an equation.

        Parameters
        ----------
        name : str
        expression : casadi.MX
            Of the program's variables and parameters.
        lower, upper : array_like
            One number for all entries, or one for each.

        Raises
        ------
        OptionError
            If the name is taken, or a bound does not fit the expression.
        """
        if name in self._rows:
            raise OptionError(f"there is a constraint '{name}' already; give another name")
        expression = ca.densify(ca.MX(expression))
        low, high = (_filled(part, expression, name) for part in (lower, upper))
        self._rows[name] = _Block(expression, low, high)

    @property
    def x(self) -> Any:
        """All variables (n, 1), ``xi`` column by column first."""
        return _stacked(self._variables)

    @property
    def p(self) -> Any:
        """All parameters (m, 1)."""
        return _stacked(self._parameters)

    @property
    def g(self) -> Any:
        """All constraints (r, 1)."""
        return _stacked(self._rows)

    @property
    def program(self) -> dict[str, Any]:
        """The program ``{x, p, f, g}`` as `casadi.nlpsol` takes it."""
        return {"x": self.x, "p": self.p, "f": self.f, "g": self.g}

    @property
    def arguments(self) -> dict[str, FloatArray]:
        """The numbers ``x0``, ``lbx``, ``ubx``, ``lbg``, ``ubg`` and ``p`` as a CasADi solver takes them.

        Raises
        ------
        OptionError
            If a parameter has no value.
        """
        missing = [name for name, block in self._parameters.items() if block.value is None]
        if missing:
            raise OptionError(f"parameter '{missing[0]}' has no value; call set_parameter")
        variables, rows = self._variables.values(), self._rows.values()
        return {
            "x0": _numbers(block.value for block in variables),
            "lbx": _numbers(block.lower for block in variables),
            "ubx": _numbers(block.upper for block in variables),
            "lbg": _numbers(block.lower for block in rows),
            "ubg": _numbers(block.upper for block in rows),
            "p": _numbers(block.value for block in self._parameters.values()),
        }

    @property
    def blocks(self) -> dict[str, dict[str, slice]]:
        """Where each named block stands in ``x``, ``p`` and ``g``."""
        return {"x": _slices(self._variables), "p": _slices(self._parameters), "g": _slices(self._rows)}

    def unpack(self, x: ArrayLike) -> dict[str, FloatArray]:
        """Return the numbers of each variable, in its shape, from those of ``x`` (n,)."""
        flat = np.asarray(x, dtype=np.float64).ravel()
        shapes = {name: block.expression.shape for name, block in self._variables.items()}
        return {name: flat[part].reshape(shapes[name], order="F") for name, part in self.blocks["x"].items()}

    def solver(self, options: ProgramOptions | None = None) -> NlpSolver:
        """Return a solver of the program as it now stands, to be called more than once; `options` say which and how.

        Raises
        ------
        OptionError
            If the plugin cannot be set up, or an expression has a symbol that is no variable or parameter.
        """
        self._check_symbols()
        return NlpSolver(self.program, options or ProgramOptions())

    def solve(self, options: ProgramOptions | None = None) -> NlpSolution:
        """Return what a solver with these `options` finds from the guess; it need not hold the constraints.

        Raises
        ------
        OptionError
            As of `solver`, or if a parameter has no value.
        """
        with one_blas_thread():
            return self.solver(options).solve(**self.arguments)

    def add_to_opti(self, opti: Any) -> OptiTerms:
        """Put variables, parameters, bounds and constraints into the `casadi.Opti` problem `opti`, with their values.

        Returns
        -------
        OptiTerms
            An Opti problem has one objective: pass it the ``cost`` of this with your own terms.

        Raises
        ------
        OptionError
            If an expression has a symbol that is no variable or parameter.
        """
        self._check_symbols()
        values = {}
        for name, block in self._variables.items():
            variable = values[name] = opti.variable(*block.expression.shape)
            opti.set_initial(variable, block.value)
            _bound(opti, variable, block)
        for name, block in self._parameters.items():
            values[name] = opti.parameter(*block.expression.shape)
            if block.value is not None:
                opti.set_value(values[name], block.value)
        symbols = [block.expression for block in (*self._variables.values(), *self._parameters.values())]
        rows = [block.expression for block in self._rows.values()]
        whole = ca.Function("regrasp_nlp", symbols, [self.f, self.scores, *rows])
        cost, scores, *rows = whole.call([*values.values()], True, False)
        for row, block in zip(rows, self._rows.values(), strict=True):
            _bound(opti, row, block)
        return OptiTerms(values, cost, scores)

    def _check_symbols(self) -> None:
        whole = ca.Function("whole", [self.x, self.p], [self.f, self.g], {"allow_free": True})
        free = [symbol.name() for symbol in whole.free_mx()]
        if free:
            raise OptionError(f"'{free[0]}' is neither a variable nor a parameter of the program; add it as one")

    def _symbol(self, name: str, shape: int | tuple[int, int]) -> Any:
        if name in self._variables or name in self._parameters:
            raise OptionError(f"there is a variable or parameter '{name}' already; give another name")
        return ca.MX.sym(name, *((shape, 1) if isinstance(shape, int) else shape))


def _filled(value: ArrayLike, expression: Any, name: str) -> FloatArray:
    """Return `value` in the shape of `expression`."""
    numbers = np.asarray(value, dtype=np.float64)
    numbers = numbers[:, None] if numbers.ndim == 1 else numbers
    if np.isnan(numbers).any():
        raise OptionError(f"'{name}' is given NaN; give numbers")
    try:
        return np.array(np.broadcast_to(numbers, expression.shape))
    except ValueError as error:
        raise OptionError(f"'{name}' has shape {expression.shape}, its numbers have {numbers.shape}") from error


def _stacked(blocks: Mapping[str, _Block]) -> Any:
    return ca.vertcat(*[ca.vec(block.expression) for block in blocks.values()]) if blocks else ca.MX(0, 1)


def _numbers(parts: Iterable[FloatArray | None]) -> FloatArray:
    columns = [part.ravel(order="F") for part in parts if part is not None]
    return np.concatenate(columns) if columns else np.zeros(0)


def _slices(blocks: Mapping[str, _Block]) -> dict[str, slice]:
    sizes = [block.expression.numel() for block in blocks.values()]
    edges = itertools.pairwise(itertools.accumulate(sizes, initial=0))
    return {name: slice(*edge) for name, edge in zip(blocks, edges, strict=True)}


def _bound(opti: Any, expression: Any, block: _Block) -> None:
    """Demand a block's bounds of `expression` where they are finite."""
    assert block.lower is not None and block.upper is not None
    low, high = block.lower.ravel(order="F"), block.upper.ravel(order="F")
    finite = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
    if len(finite):
        opti.subject_to(opti.bounded(low[finite], ca.vec(expression)[finite.tolist()], high[finite]))
