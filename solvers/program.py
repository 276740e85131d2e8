"""The nonlinear program of one (energy, N, number of grasps): built once, solved for many parameters.

It is a `RegraspNLP` whose placements and ends are parameters, with a limit on the pair scores where one is set:

    Q_pair(T_i, T_{i+1}) <= pair_limit          for each pair
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.casadi_costs import parametric_functions
from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.options import ProgramOptions
from regrasp_opt.solvers.regrasp_nlp import RegraspNLP

_ANYWHERE = np.array([[-np.inf], [np.inf]])


class Solve(NamedTuple):
    """One local solve: planar parameters (N, 3), their cost, how the solver ended and its cost by iteration.

    ``evaluations`` counts calls of ``J_seq`` and of its derivatives; ``path`` (k, N, 3) has the iterations if
    `ProgramOptions.record` is set, else none.
    """

    xi: FloatArray
    cost: float
    status: str
    converged: bool
    improved: bool
    iterations: int
    evaluations: int
    trace: FloatArray
    path: FloatArray


class SequenceProgram:
    """A CasADi solver for ``J_seq`` with `num_regrasps` intermediate poses; see the module docstring.

    Raises
    ------
    OptionError
        For the truncated cost, or a plugin that cannot be set up.
    """

    def __init__(self, energy: CasadiEnergy, options: CostOptions, num_regrasps: int, settings: ProgramOptions) -> None:
        if options.variant == "Jh":
            raise OptionError("the truncated cost Jh is not differentiable; use variant J or J+ with a gradient solver")
        self.settings = settings
        self._functions = parametric_functions(energy, options, num_regrasps, blocking=True)
        nlp = RegraspNLP(self._functions, _ANYWHERE, np.zeros((num_regrasps, 3)))
        if settings.pair_limit is not None:
            nlp.add_constraint("pairs", nlp.scores, upper=settings.pair_limit)
        self._solver = nlp.solver(settings)

    def solve(
        self,
        xi: FloatArray,
        layers: FloatArray,
        blocked: BoolArray,
        ends: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
    ) -> Solve:
        """Solve from `xi` (N, 3) with the parameters of `parametric_functions` within `bounds`, low and high (N, 3).

        `layers` is (H, (3 G + 2) N), `blocked` (N, G) and `ends` (G, 2), the energies at start and goal. The start is
        returned where the solver finds nothing cheaper, or ends outside the constraints.
        """
        low, high = (side.ravel() for side in bounds)
        x0 = np.clip(xi.ravel(), low, high)
        start_cost = float(self._functions.J_seq(x0.reshape(-1, 3), layers, blocked.T, *ends.T))
        packed = np.concatenate([layers.T.ravel(), blocked.ravel(), ends.T.ravel()])
        found = self._solver.solve(x0, p=packed, lbx=low, ubx=high)
        better = bool(np.isfinite(found.f) and found.f <= start_cost and found.violation <= 1e-6)
        return Solve(
            (found.x if better else x0).reshape(-1, 3),
            found.f if better else start_cost,
            found.status,
            found.converged,
            better,
            found.iterations,
            found.evaluations,
            found.trace if len(found.trace) else np.array([start_cost, found.f]),
            found.path.reshape(-1, *xi.shape),
        )
