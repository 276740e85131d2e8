"""`J_seq` as a nonlinear program over ``xi``, solved by Ipopt or another CasADi plugin.

The placements and the energies at both ends are parameters, so one solver object serves all problems with the same
energy and the same N; objects are kept for as long as the energy lives. Neither a CasADi solver nor MUMPS may be used
from two threads at once: a lock sees to it.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any, Literal
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from regrasp_opt.connectivity import CostOptions, SequenceObjective
from regrasp_opt.connectivity.casadi_costs import placement_parameter, sequence_functions
from regrasp_opt.conventions import FloatArray
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.base import Candidates, Refinement, wrap_yaw

Plugin = Literal["ipopt", "sqpmethod"]
Hessian = Literal["exact", "limited-memory"]
CONVERGED = {"Solve_Succeeded", "Solved_To_Acceptable_Level"}

_lock = threading.RLock()
_expressions: WeakKeyDictionary[GraspEnergy, CasadiEnergy] = WeakKeyDictionary()
_solvers: WeakKeyDictionary[GraspEnergy, dict[Any, Any]] = WeakKeyDictionary()


@dataclass(frozen=True)
class NlpRefiner:
    """Refine each start by one local solve within the workspace bounds; keep the start where that is not better.

    Attributes
    ----------
    plugin : {"ipopt", "sqpmethod"}
        The CasADi solver plugin.
    hessian : {"exact", "limited-memory"}
        Exact second derivatives, or a quasi-Newton approximation.
    max_iterations : int
    tolerance : float
        Ipopt's `tol`.
    """

    plugin: Plugin = "ipopt"
    hessian: Hessian = "exact"
    max_iterations: int = 100
    tolerance: float = 1e-6
    extra_options: dict[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise OptionError(f"max_iterations is {self.max_iterations}; give at least 1")
        if not self.tolerance > 0:
            raise OptionError(f"tolerance is {self.tolerance}; give a positive number")

    @property
    def name(self) -> str:
        """Short name, for reports."""
        return self.plugin if self.hessian == "exact" else f"{self.plugin}-lbfgs"

    def refine(self, objective: SequenceObjective, starts: Candidates, rng: np.random.Generator) -> Refinement:
        """Return the refined candidates; the stats count solves, converged ones, improved ones and iterations."""
        xi, cost = np.array(starts.xi), np.array(starts.cost, dtype=np.float64)
        converged = improved = 0
        iterations: list[int] = []
        statuses: dict[str, int] = {}
        with _lock:
            solver, cost_function = self._solver(objective, starts.xi.shape[1])
            ends = np.stack([objective.start_energy, objective.goal_energy], axis=1)
            bounds = _variable_bounds(objective, starts.xi.shape[1])
            for b in range(len(starts)):
                parameters = placement_parameter(objective.placements[starts.placements[b]])
                x0 = np.clip(starts.xi[b].T, *[limit.reshape(-1, 3).T for limit in bounds])
                start_cost = float(cost_function(x0, parameters, ends))
                packed = np.concatenate([parameters.T.ravel(), ends.T.ravel()])
                solution = solver(x0=x0.T.ravel(), p=packed, lbx=bounds[0], ubx=bounds[1])
                stats = solver.stats()
                status = str(stats["return_status"])
                statuses[status] = statuses.get(status, 0) + 1
                converged += status in CONVERGED or (self.plugin != "ipopt" and bool(stats["success"]))
                iterations.append(int(stats["iter_count"]))
                found = float(solution["f"])
                better = np.isfinite(found) and found <= start_cost
                improved += better
                xi[b] = np.array(solution["x"]).reshape(-1, 3) if better else x0.T
                cost[b] = found if better else start_cost
        stats = {
            "solves": len(starts),
            "converged": converged,
            "improved": improved,
            "iterations": iterations,
            "statuses": statuses,
        }
        return Refinement(Candidates(starts.placements, wrap_yaw(xi), cost), stats)

    def _solver(self, objective: SequenceObjective, num_regrasps: int) -> tuple[Any, Any]:
        known = _solvers.setdefault(objective.energy, {})
        key = (self, tuple(sorted(self.extra_options.items())), objective.options, num_regrasps)
        if key not in known:
            known[key] = self._build(objective.energy, objective.options, num_regrasps)
        return known[key]

    def _build(self, energy: GraspEnergy, options: CostOptions, num_regrasps: int) -> tuple[Any, Any]:
        functions = sequence_functions(casadi_energy(energy), options, num_regrasps)
        x = ca.MX.sym("x", 3 * num_regrasps)
        p = ca.MX.sym("p", 16 * num_regrasps + 2 * len(energy))
        inputs = [
            ca.reshape(x, 3, num_regrasps),
            ca.reshape(p[: 16 * num_regrasps], 4, 4 * num_regrasps),
            ca.reshape(p[16 * num_regrasps :], len(energy), 2),
        ]
        cost, gradient = functions.gradient(*inputs)
        nlp = {"x": x, "p": p, "f": functions.cost(*inputs)}
        settings: dict[str, Any] = {"print_time": False}
        if self.plugin == "ipopt":
            settings["grad_f"] = ca.Function("grad_f", [x, p], [cost, gradient], ["x", "p"], ["f", "grad_f_x"])
        else:
            nothing = [ca.MX(0, 1), ca.MX(0, 3 * num_regrasps)]  # no constraints
            settings["jac_fg"] = ca.Function(
                "jac_fg", [x, p], [cost, gradient, *nothing], ["x", "p"], ["f", "grad_f_x", "g", "jac_g_x"]
            )
        scale, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
        if self.hessian == "exact":
            hessian = scale * functions.hessian(*inputs)
            settings["hess_lag"] = ca.Function(
                "hess_lag",
                [x, p, scale, multipliers],
                [ca.triu(hessian) if self.plugin == "ipopt" else hessian],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            )
        settings.update(self._plugin_options(), **self.extra_options)
        return ca.nlpsol("regrasp", self.plugin, nlp, settings), functions.cost

    def _plugin_options(self) -> dict[str, Any]:
        if self.plugin == "ipopt":
            return {
                "ipopt": {
                    "print_level": 0,
                    "sb": "yes",
                    "max_iter": self.max_iterations,
                    "tol": self.tolerance,
                    "hessian_approximation": self.hessian,
                    # A sampled start is good: begin with a small barrier and do not push it off its bounds.
                    "mu_init": 1e-4,
                    "bound_push": 1e-8,
                    "bound_frac": 1e-8,
                    "bound_relax_factor": 0.0,
                }
            }
        return {
            "max_iter": self.max_iterations,
            "hessian_approximation": self.hessian,
            "qpsol": "qrqp",
            "convexify_strategy": "regularize",
            "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
            "print_header": False,
            "print_iteration": False,
            "print_status": False,
            "error_on_fail": False,
        }


def casadi_energy(energy: GraspEnergy) -> CasadiEnergy:
    """Return the CasADi expressions of `energy`, built once for as long as it lives."""
    with _lock:
        if energy not in _expressions:
            _expressions[energy] = CasadiEnergy(energy)
        return _expressions[energy]


def _variable_bounds(objective: SequenceObjective, num_regrasps: int) -> tuple[FloatArray, FloatArray]:
    low, high = (np.append(side, end) for side, end in zip(objective.bounds, (-np.inf, np.inf), strict=True))
    return np.tile(low, num_regrasps), np.tile(high, num_regrasps)
