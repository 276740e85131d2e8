"""A nonlinear program put together from named blocks: the one builder behind every Ipopt call of the package.

minimise    f(x, p)
subject to  lower <= x <= upper
            lower <= g(x, p) <= upper

Variables, parameters and constraints have names; the numbers that go with them (bounds, first guess, values) are arrays
of their shape. `x` and `g` hold the blocks one after the other, each row by row as in NumPy; `p` holds them column by
column as in CasADi.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.nlp_solver import NlpSolution, NlpSolver
from regrasp_opt.solvers.options import ProgramOptions
from regrasp_opt.threads import one_blas_thread


@dataclass(frozen=True, eq=False)
class _Block:
    """An expression, flat in the order of its numbers, with these: bounds and guess, or a parameter's value."""

    flat: Any
    shape: tuple[int, int]
    lower: FloatArray | None = None
    upper: FloatArray | None = None
    value: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class _Rows(_Block):
    """A constraint with the names of its rows, and what one unit of them is in the user's unit."""

    labels: Sequence[str] = ()
    scale: float = 1.0
    unit: str = ""


class NonlinearProgram:
    """The program ``{x, p, f, g}``; see the module docstring.

    Parameters
    ----------
    symbols : type
        `casadi.MX`, or `casadi.SX` for small programs without calls of functions.

    Attributes
    ----------
    f : expression
        What is minimised.
    """

    def __init__(self, symbols: Any = ca.MX) -> None:
        self._symbols = symbols
        self._variables: dict[str, _Block] = {}
        self._parameters: dict[str, _Block] = {}
        self._rows: dict[str, _Rows] = {}
        self.f = symbols(0)

    def variable(
        self,
        name: str,
        shape: int | tuple[int, int] = 1,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        guess: ArrayLike = 0.0,
    ) -> Any:
        """Add a variable within bounds and return its expression.

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
            Of the given shape.

        Raises
        ------
        OptionError
            If the name is taken, a bound or the guess does not fit the shape, or a lower bound is above its upper one.
        """
        rows, columns = self._fresh(name, shape)
        symbol = self._symbols.sym(name, columns, rows) if columns > 1 else self._symbols.sym(name, rows)
        low, high, start = (_filled(part, (rows, columns), name) for part in (lower, upper, guess))
        if (low > high).any():
            raise OptionError(f"variable '{name}' has a lower bound above its upper bound")
        self._variables[name] = _Block(ca.vec(symbol), (rows, columns), low, high, start)
        return symbol.T if columns > 1 else symbol

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
        symbol = self._symbols.sym(name, *self._fresh(name, shape))
        self._parameters[name] = _Block(ca.vec(symbol), symbol.shape)
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
        block = self._parameters[name]
        self._parameters[name] = _Block(block.flat, block.shape, value=_filled(value, block.shape, name))

    def add_cost(self, term: Any) -> None:
        """Add the scalar expression `term` to what is minimised.

        Raises
        ------
        OptionError
            If it is not a scalar.
        """
        if self._symbols(term).shape != (1, 1):
            raise OptionError(f"a cost has shape {self._symbols(term).shape}; give a scalar expression")
        self.f = self.f + term

    def add_constraint(
        self,
        name: str,
        expression: Any,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        labels: Sequence[str] = (),
        scale: float = 1.0,
        unit: str = "",
    ) -> None:
        """Require ``lower <= expression <= upper``, elementwise; equal bounds make an equation.

        Parameters
        ----------
        name : str
        expression : casadi.MX
            Of the program's variables and parameters.
        lower, upper : array_like
            One number for all entries, or one for each.
        labels : sequence of str, optional
            What each row is called in `worst_violation`; `name` by default.
        scale, unit
            One unit of a row is `scale` of the `unit` that `worst_violation` shows.

        Raises
        ------
        OptionError
            If the name is taken, or a bound does not fit the expression.
        """
        if name in self._rows:
            raise OptionError(f"there is a constraint '{name}' already; give another name")
        expression = ca.densify(self._symbols(expression))
        shape = expression.shape
        low, high = (_filled(part, shape, name) for part in (lower, upper))
        flat = ca.vec(expression.T)
        self._rows[name] = _Rows(flat, shape, low, high, None, labels or [name] * flat.numel(), scale, unit)

    @property
    def x(self) -> Any:
        """All variables (n, 1)."""
        return self._stacked(self._variables)

    @property
    def p(self) -> Any:
        """All parameters (m, 1)."""
        return self._stacked(self._parameters)

    @property
    def g(self) -> Any:
        """All constraints (r, 1)."""
        return self._stacked(self._rows)

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
        variables, (lbg, ubg) = self._variables.values(), self._row_bounds
        return {
            "x0": _numbers(block.value for block in variables),
            "lbx": _numbers(block.lower for block in variables),
            "ubx": _numbers(block.upper for block in variables),
            "lbg": lbg,
            "ubg": ubg,
            "p": _numbers((block.value for block in self._parameters.values()), order="F"),
        }

    @property
    def _row_bounds(self) -> tuple[FloatArray, FloatArray]:
        """The bounds (r,) of the constraints."""
        rows = self._rows.values()
        return _numbers(row.lower for row in rows), _numbers(row.upper for row in rows)

    @property
    def blocks(self) -> dict[str, dict[str, slice]]:
        """Where each named block stands in ``x``, ``p`` and ``g``."""
        return {"x": _slices(self._variables), "p": _slices(self._parameters), "g": _slices(self._rows)}

    def unpack(self, x: ArrayLike) -> dict[str, FloatArray]:
        """Return the numbers of each variable, in its shape, from those of ``x`` (n,)."""
        flat = np.asarray(x, dtype=np.float64).ravel()
        return {name: flat[part].reshape(self._variables[name].shape) for name, part in self.blocks["x"].items()}

    def worst_violation(self, g: ArrayLike, tolerance: float) -> str:
        """Return which row of the constraints' values `g` (r,) is violated most and by how much.

        Empty where none is violated by more than `tolerance`.
        """
        values = np.asarray(g, dtype=np.float64)
        if not np.isfinite(values).all():
            return "the solver left numbers that are not finite"
        labels = [(label, rows.scale, rows.unit) for rows in self._rows.values() for label in rows.labels]
        if not labels:
            return ""
        low, high = self._row_bounds
        excess = np.maximum(low - values, values - high)
        worst = int(excess.argmax())
        if excess[worst] <= tolerance:
            return ""
        label, scale, unit = labels[worst]
        return f"{label} is violated by {scale * excess[worst]:.2g}{unit}"

    def solver(self, options: ProgramOptions | None = None) -> NlpSolver:
        """Return a solver of the program as it now stands, to be called more than once; `options` say which and how.

        Raises
        ------
        OptionError
            If the plugin cannot be set up, or an expression has a symbol that is neither a variable nor a parameter.
        """
        self._check_symbols()
        return NlpSolver(self.program, options or ProgramOptions(), self._row_bounds)

    def solve(self, options: ProgramOptions | None = None) -> NlpSolution:
        """Return what a solver with these `options` finds from the guess; it need not satisfy the constraints.

        Raises
        ------
        OptionError
            Same as `solver`, or if a parameter has no value.
        """
        with one_blas_thread():
            return self.solver(options).solve(**self.arguments)

    def put_into_opti(self, opti: Any, *expressions: Any) -> tuple[dict[str, Any], list[Any]]:
        """Put variables, parameters, bounds and constraints into the `casadi.Opti` problem `opti`, with their values.

        Returns
        -------
        values : dict
            Variables and parameters of `opti` by name.
        expressions : list
            The given `expressions` of this program in those of `opti`.

        Raises
        ------
        OptionError
            If an expression has a symbol that is neither a variable nor a parameter.
        """
        self._check_symbols()
        values, flat = {}, []
        for name, block in self._variables.items():
            variable = values[name] = opti.variable(*block.shape)
            opti.set_initial(variable, block.value)
            flat.append(ca.vec(variable.T))
            _bound(opti, flat[-1], block)
        for name, block in self._parameters.items():
            values[name] = opti.parameter(*block.shape)
            flat.append(ca.vec(values[name]))
            if block.value is not None:
                opti.set_value(values[name], block.value)
        rows = [block.flat for block in self._rows.values()]
        whole = ca.Function("program", [self.x, self.p], [*expressions, *rows])
        count = len(self._variables)
        stacked = [ca.vertcat(*part) if part else ca.MX(0, 1) for part in (flat[:count], flat[count:])]
        found = whole.call(stacked, True, False)
        for row, block in zip(found[len(expressions) :], self._rows.values(), strict=True):
            _bound(opti, row, block)
        return values, found[: len(expressions)]

    def _check_symbols(self) -> None:
        whole = ca.Function("whole", [self.x, self.p], [self.f, self.g], {"allow_free": True})
        free = whole.free_mx() if self._symbols is ca.MX else whole.free_sx()
        if free:
            name = free[0].name()
            raise OptionError(f"'{name}' is neither a variable nor a parameter of the program; add it as one")

    def _fresh(self, name: str, shape: int | tuple[int, int]) -> tuple[int, int]:
        if name in self._variables or name in self._parameters:
            raise OptionError(f"there is a variable or parameter '{name}' already; give another name")
        return (shape, 1) if isinstance(shape, int) else shape

    def _stacked(self, blocks: Mapping[str, _Block]) -> Any:
        return ca.vertcat(*[block.flat for block in blocks.values()]) if blocks else self._symbols(0, 1)


def _filled(value: ArrayLike, shape: tuple[int, int], name: str) -> FloatArray:
    """Return `value` in the shape of an expression."""
    numbers = np.asarray(value, dtype=np.float64)
    numbers = numbers[:, None] if numbers.ndim == 1 and shape[1] == 1 else numbers
    if np.isnan(numbers).any():
        raise OptionError(f"'{name}' is given NaN; give numbers")
    try:
        return np.array(np.broadcast_to(numbers, shape))
    except ValueError as error:
        raise OptionError(f"'{name}' has shape {shape}, but its numbers have {numbers.shape}") from error


def _numbers(parts: Iterable[FloatArray | None], order: Any = "C") -> FloatArray:
    flat = [part.ravel(order=order) for part in parts if part is not None]
    return np.concatenate(flat) if flat else np.zeros(0)


def _slices(blocks: Mapping[str, _Block]) -> dict[str, slice]:
    sizes = [block.flat.numel() for block in blocks.values()]
    edges = itertools.pairwise(itertools.accumulate(sizes, initial=0))
    return {name: slice(*edge) for name, edge in zip(blocks, edges, strict=True)}


def _bound(opti: Any, flat: Any, block: _Block) -> None:
    """Require a block's bounds of its entries `flat` where they are finite."""
    assert block.lower is not None and block.upper is not None
    low, high = block.lower.ravel(), block.upper.ravel()
    finite = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
    if len(finite):
        opti.subject_to(opti.bounded(low[finite], flat[finite.tolist()], high[finite]))
