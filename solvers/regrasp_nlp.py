"""The search for intermediate poses as a nonlinear program that can be extended before it is solved.

minimise    J_seq(xi) + own costs                       (Eq. 5)
subject to  low_i <= xi_i <= high_i                     for each intermediate pose
            own constraints

``xi`` (N, 3) is the first block of the variables ``x``. Own variables, parameters, costs and constraints are CasADi
expressions; the functions behind ``J_seq`` bring their derivatives along (`regrasp_opt.energy.casadi_function`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.connectivity.casadi_costs import ConnectivityFunctions
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.nonlinear_program import NonlinearProgram


class OptiTerms(NamedTuple):
    """What `RegraspNLP.add_to_opti` has put into an Opti problem, as that problem's expressions.

    ``values`` holds the variables and parameters by name, ``xi`` among them; ``cost`` is to be minimised, together with
    whatever else; ``scores`` (N+1, 1) are the pair scores.
    """

    values: dict[str, Any]
    cost: Any
    scores: Any


class RegraspNLP(NonlinearProgram):
    """The program ``{x, p, f, g}`` over the planar parameters of N intermediate poses; see the module docstring.

    Parameters
    ----------
    functions : ConnectivityFunctions
        Of ``xi`` (N, 3) and any further inputs, which become parameters.
    bounds : pair of (N, 3)
        Least and largest planar parameters [m, m, rad] of each pose; anything that broadcasts to it.
    guess : (N, 3)
        Planar parameters [m, m, rad] to start from.
    values : mapping, optional
        Values of the functions' further inputs by name.

    Attributes
    ----------
    functions : ConnectivityFunctions
    xi : casadi.MX (N, 3)
        Planar parameters of the intermediate poses.
    cost : casadi.MX
        ``J_seq`` without own costs.
    f : casadi.MX
        What is minimised.
    """

    def __init__(
        self,
        functions: ConnectivityFunctions,
        bounds: Any,
        guess: ArrayLike,
        values: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        super().__init__()
        J_seq = functions.J_seq
        count = J_seq.size1_in(0)
        start = np.asarray(guess, dtype=np.float64)
        if start.shape != (count, 3) or not np.isfinite(start).all():
            raise OptionError(f"the guess has shape {start.shape}; give {count} finite rows (x, y, theta)")
        self.functions = functions
        low, high = (np.broadcast_to(side, (count, 3)) for side in bounds)
        self.xi = self.variable("xi", (count, 3), lower=low, upper=high, guess=start)
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

    def add_to_opti(self, opti: Any) -> OptiTerms:
        """Put variables, parameters, bounds and constraints into the `casadi.Opti` problem `opti`, with their values.

        Returns
        -------
        OptiTerms
            An Opti problem has one objective: pass it the ``cost`` of this with your own terms.

        Raises
        ------
        OptionError
            If an expression has a symbol that is neither a variable nor a parameter.
        """
        values, (cost, scores) = self.put_into_opti(opti, self.f, self.scores)
        return OptiTerms(values, cost, scores)
