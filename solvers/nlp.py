"""`J_seq` as a nonlinear program over ``xi``, solved by Ipopt or another CasADi plugin.

The first layers at the chosen placements and the energies at both ends are parameters, so one solver object serves
all problems with the same energy, N and number of grasps; objects are kept for as long as the energy lives.

With one regrasp every pair has a fixed end, and a grasp that is known to be infeasible at both ends adds at most
``exp(-BLOCKED / alpha)`` to a sum (Eq. 4): such grasps are left out, which is where most of the work goes.

Neither a CasADi solver nor MUMPS may be used from two threads at once: a lock sees to it.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any, Literal
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from regrasp_opt.connectivity import BLOCKED, CostOptions, SequenceObjective
from regrasp_opt.connectivity.casadi_costs import layers_parameter, sequence_functions
from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.base import Candidates, Refinement, wrap_yaw

Plugin = Literal["ipopt", "sqpmethod"]
Hessian = Literal["exact", "limited-memory"]
ACTIVE_SIZES = (16, 32, 48, 64, 96, 128, 192)
"""Numbers of grasps for which solvers are built; more than the last takes all grasps."""
CONVERGED = {"Solve_Succeeded", "Solved_To_Acceptable_Level"}

_lock = threading.RLock()
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
        num_regrasps = starts.xi.shape[1]
        ids, ends = _active_grasps(objective, num_regrasps)
        low, high = _variable_bounds(objective, num_regrasps)
        with _lock:
            solver, cost_function = self._solver(objective, num_regrasps, len(ids))
            for b in range(len(starts)):
                layers = layers_parameter(objective.energy, objective.placements[starts.placements[b]], ids)
                x0 = np.clip(starts.xi[b].ravel(), low, high)
                start_cost = float(cost_function(x0.reshape(-1, 3).T, layers, ends))
                packed = np.concatenate([layers.T.ravel(), ends.T.ravel()])
                solution = solver(x0=x0, p=packed, lbx=low, ubx=high)
                stats = solver.stats()
                status = str(stats["return_status"])
                statuses[status] = statuses.get(status, 0) + 1
                converged += status in CONVERGED or (self.plugin != "ipopt" and bool(stats["success"]))
                iterations.append(int(stats["iter_count"]))
                found = float(solution["f"])
                better = np.isfinite(found) and found <= start_cost
                improved += better
                xi[b] = np.array(solution["x"]).reshape(-1, 3) if better else x0.reshape(-1, 3)
                cost[b] = found if better else start_cost
        stats = {
            "solves": len(starts),
            "grasps": len(ids),
            "converged": converged,
            "improved": improved,
            "iterations": iterations,
            "statuses": statuses,
        }
        return Refinement(Candidates(starts.placements, wrap_yaw(xi), cost), stats)

    def _solver(self, objective: SequenceObjective, num_regrasps: int, grasps: int) -> tuple[Any, Any]:
        known = _solvers.setdefault(objective.energy, {})
        key = (self, tuple(sorted(self.extra_options.items())), objective.options, num_regrasps, grasps)
        if key not in known:
            expressions = CasadiEnergy(objective.energy.model, grasps)
            known[key] = self._build(expressions, objective.options, num_regrasps)
        return known[key]

    def _build(self, energy: CasadiEnergy, options: CostOptions, num_regrasps: int) -> tuple[Any, Any]:
        functions = sequence_functions(energy, options, num_regrasps)
        columns = 3 * energy.count * num_regrasps
        size = energy.model.hidden * columns
        x = ca.MX.sym("x", 3 * num_regrasps)
        p = ca.MX.sym("p", size + 2 * energy.count)
        inputs = [
            ca.reshape(x, 3, num_regrasps),
            ca.reshape(p[:size], energy.model.hidden, columns),
            ca.reshape(p[size:], energy.count, 2),
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


def _active_grasps(objective: SequenceObjective, num_regrasps: int) -> tuple[IntArray, FloatArray]:
    """Return the grasps (A,) that can matter and their energies (A, 2) at both ends.

    A is rounded up to one of a few sizes, so that solvers can be kept; what fills it up is blocked at both ends.
    """
    ends = np.stack([objective.start_energy, objective.goal_energy], axis=1)
    useful = np.flatnonzero((ends < BLOCKED).any(axis=1))
    size = next((n for n in ACTIVE_SIZES if n >= len(useful)), len(ends))
    if num_regrasps > 1 or size >= len(ends):
        return np.arange(len(ends)), ends
    order = np.argsort((ends >= BLOCKED).all(axis=1), kind="stable")[:size]
    return order, ends[order]


def _variable_bounds(objective: SequenceObjective, num_regrasps: int) -> tuple[FloatArray, FloatArray]:
    low, high = (np.append(side, end) for side, end in zip(objective.bounds, (-np.inf, np.inf), strict=True))
    return np.tile(low, num_regrasps), np.tile(high, num_regrasps)
