"""The nonlinear program of one (energy, N, number of grasps): built once, solved for many parameters.

minimise    J_seq(xi)                                   (Eq. 5)
subject to  low <= (x_i, y_i) <= high                   for each intermediate pose
Q_pair(T_i, T_{i+1}) <= pair_limit          for each pair, where a limit is set
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.casadi_costs import SequenceFunctions, sequence_functions
from regrasp_opt.conventions import FloatArray
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.errors import OptionError

Hessian = Literal["exact", "limited-memory"]
CONVERGED = {"Solve_Succeeded", "Solved_To_Acceptable_Level"}


@dataclass(frozen=True)
class ProgramOptions:
    """How the program is solved.

    Attributes
    ----------
    plugin : str
        Any CasADi NLP plugin, for example ``ipopt`` or ``sqpmethod``.
    hessian : {"exact", "limited-memory"}
        Exact second derivatives, or a quasi-Newton approximation.
    max_iterations : int
    tolerance : float
        On the first-order conditions.
    pair_limit : float, optional
        Largest ``Q_pair`` allowed between neighbours; None leaves the pairs to the cost.
    """

    plugin: str = "ipopt"
    hessian: Hessian = "exact"
    max_iterations: int = 100
    tolerance: float = 1e-5
    pair_limit: float | None = None

    def __post_init__(self) -> None:
        if not ca.has_nlpsol(self.plugin):
            raise OptionError(f"CasADi has no NLP plugin '{self.plugin}'; use for example ipopt or sqpmethod")
        if self.hessian not in ("exact", "limited-memory"):
            raise OptionError(f"hessian '{self.hessian}' is unknown; use exact or limited-memory")
        if self.max_iterations < 1:
            raise OptionError(f"max_iterations is {self.max_iterations}; give at least 1")
        if not self.tolerance > 0:
            raise OptionError(f"tolerance is {self.tolerance}; give a positive number")


class Solve(NamedTuple):
    """One local solve: planar parameters (N, 3), their cost, how the solver ended and its cost by iteration.

    ``evaluations`` counts calls of ``J_seq`` and of its derivatives.
    """

    xi: FloatArray
    cost: float
    status: str
    converged: bool
    improved: bool
    iterations: int
    evaluations: int
    trace: FloatArray


class SequenceProgram:
    """A CasADi solver for ``J_seq`` with `num_regrasps` intermediate poses; see the module docstring."""

    def __init__(self, energy: CasadiEnergy, options: CostOptions, num_regrasps: int, settings: ProgramOptions) -> None:
        self.settings = settings
        self.num_regrasps = num_regrasps
        self._functions = sequence_functions(energy, options, num_regrasps)
        self._solver = _build(energy, self._functions, num_regrasps, settings)

    def solve(self, xi: FloatArray, layers: FloatArray, ends: FloatArray, bounds: FloatArray) -> Solve:
        """Solve from `xi` (N, 3) with the parameters of `SequenceFunctions` and workspace `bounds` (2, 2).

        The start is returned where the solver finds nothing cheaper, or ends outside the constraints.
        """
        low, high = (
            np.tile(np.append(side, e), self.num_regrasps) for side, e in zip(bounds, (-np.inf, np.inf), strict=True)
        )
        x0 = np.clip(xi.ravel(), low, high)
        start_cost = float(self._functions.cost(x0.reshape(-1, 3).T, layers, ends))
        packed = np.concatenate([layers.T.ravel(), ends.T.ravel()])
        limit = self.settings.pair_limit
        rows = {} if limit is None else {"lbg": -np.inf, "ubg": limit}
        solution = self._solver(x0=x0, p=packed, lbx=low, ubx=high, **rows)
        stats = self._solver.stats()
        status = str(stats.get("return_status", "unknown"))
        found, x = float(solution["f"]), np.array(solution["x"]).ravel()
        allowed = limit is None or bool((np.array(solution["g"]) <= limit + 1e-6).all())
        better = bool(np.isfinite(found) and found <= start_cost and allowed)
        return Solve(
            (x if better else x0).reshape(-1, 3),
            found if better else start_cost,
            status,
            status in CONVERGED or (self.settings.plugin != "ipopt" and bool(stats.get("success", False))),
            better,
            int(stats.get("iter_count", 0)),
            sum(int(count) for name, count in stats.items() if name.startswith("n_call_nlp_")),
            np.array(stats.get("iterations", {}).get("obj", [start_cost, found]), dtype=np.float64),
        )


def _build(energy: CasadiEnergy, functions: SequenceFunctions, num_regrasps: int, settings: ProgramOptions) -> Any:
    columns = 3 * energy.count * num_regrasps
    size = energy.model.hidden * columns
    x = ca.MX.sym("x", 3 * num_regrasps)
    p = ca.MX.sym("p", size + 2 * energy.count)
    inputs = [
        ca.reshape(x, 3, num_regrasps),
        ca.reshape(p[:size], energy.model.hidden, columns),
        ca.reshape(p[size:], energy.count, 2),
    ]
    nlp = {"x": x, "p": p, "f": functions.cost(*inputs)}
    constrained = settings.pair_limit is not None
    g, jacobian = functions.scores(*inputs) if constrained else (ca.MX(0, 1), ca.MX(0, x.shape[0]))
    if constrained:
        nlp["g"] = g
    chosen: dict[str, Any] = {"print_time": False, **_plugin_options(settings)}
    chosen.update(_derivatives(functions, x, p, inputs, (g, jacobian), settings))
    try:
        return ca.nlpsol("regrasp", settings.plugin, nlp, chosen)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise OptionError(f"CasADi cannot set up the plugin '{settings.plugin}' ({reason}); use ipopt") from error


def _derivatives(
    functions: SequenceFunctions, x: Any, p: Any, inputs: list[Any], rows: tuple[Any, Any], settings: ProgramOptions
) -> dict[str, Any]:
    """Return our derivatives under the names that the plugin takes them by; other plugins let CasADi differentiate."""
    if settings.plugin not in ("ipopt", "sqpmethod"):
        return {}
    g, jacobian = rows
    cost, gradient = functions.gradient(*inputs)
    scale, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.shape[0])
    weights = multipliers if g.shape[0] else ca.MX.zeros(x.shape[0] // 3 + 1)
    hessian = functions.hessian(*inputs, scale, weights)
    options = {}
    if settings.plugin == "ipopt":
        hessian = ca.triu(hessian)
        options["grad_f"] = ca.Function("grad_f", [x, p], [cost, gradient], ["x", "p"], ["f", "grad_f_x"])
        if g.shape[0]:
            options["jac_g"] = ca.Function("jac_g", [x, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"])
    else:
        outputs = [cost, gradient, g, jacobian]
        options["jac_fg"] = ca.Function("jac_fg", [x, p], outputs, ["x", "p"], ["f", "grad_f_x", "g", "jac_g_x"])
    if settings.hessian == "exact":
        names = ["x", "p", "lam_f", "lam_g"]
        options["hess_lag"] = ca.Function(
            "hess_lag", [x, p, scale, multipliers], [hessian], names, ["triu_hess_gamma_x_x"]
        )
    return options


def _plugin_options(settings: ProgramOptions) -> dict[str, Any]:
    if settings.plugin == "ipopt":
        return {
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": settings.max_iterations,
                "tol": settings.tolerance,
                "hessian_approximation": settings.hessian,
                # A sampled start is good: begin with a small barrier and do not push it off its bounds.
                "mu_init": 1e-4,
                "bound_push": 1e-8,
                "bound_frac": 1e-8,
                "bound_relax_factor": 0.0,
            }
        }
    if settings.plugin == "sqpmethod":
        return {
            "max_iter": settings.max_iterations,
            "tol_du": settings.tolerance,
            "hessian_approximation": settings.hessian,
            "qpsol": "qrqp",
            "convexify_strategy": "regularize",
            "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
            "print_header": False,
            "print_iteration": False,
            "print_status": False,
            "error_on_fail": False,
        }
    return {}
