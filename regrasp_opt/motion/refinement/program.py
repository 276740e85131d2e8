"""The joint problem as one nonlinear program over intermediate poses and all pick and place configurations.

    minimise    travel(q)  or  -s,   plus  weight * J_seq(xi)     s: least clearance or manipulability
    subject to  FK(q_ij) = T_i(xi) @ T_object_flange_i            i: transition, j: pick or place
                lower <= q_ij <= upper,  low <= (x, y) <= high
                clearance(q_ij, T_i(xi)) >= what is required      capsules around the bodies
                travel, clearance, manipulability, J_seq          within the bounds that are given

The kinematic residual is the position error in units of `POSITION_UNIT` and the vector of ``(R_t' R - R' R_t) / 2``,
whose derivative at the solution is the angular velocity: six rows of one size, none of them squared.

The capsules are larger than the bodies. A clearance that is short at a start verified by the exact check need not grow;
it may not shrink.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.refinement.bodies import Rows, configuration_rows, object_rows
from regrasp_opt.motion.refinement.candidates import CandidateCheck, JointChoice
from regrasp_opt.motion.refinement.measures import Measure
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.robots.casadi_kinematics import flange_jacobian, forward_kinematics
from regrasp_opt.solvers.nonlinear_program import NonlinearProgram
from regrasp_opt.solvers.options import ProgramOptions

POSITION_UNIT = 0.1
"""Length that weighs as much as an angle of one radian in kinematic residuals [m]."""

CLEARANCE_UNIT, MANIPULABILITY_UNIT = 0.01, 0.01
"""Sizes [m, 1] by which clearance and manipulability are divided in the program."""

FEASIBLE = 1e-5
"""Violation of a row that still counts as rounding; what it leaves undone is settled before the exact check."""

SMOOTHING = 1e-4
"""Lengths of legs are ``sqrt(|dq|^2 + SMOOTHING^2)`` [rad]."""


class JointFunctions(NamedTuple):
    """What all programs of one problem share, as `casadi.Function`.

    `residual` is the kinematic residual (6, 1) of ``q`` (dof,) and the flange wanted, ``T`` (4, 4) T_world_flange,
    `manipulability` a function of ``q``. `clearances` are those of arm and gripper at ``q`` with the object at ``T``,
    `object_clearances` those of the object at ``T``.
    """

    residual: Any
    manipulability: Any
    clearances: Rows
    object_clearances: Rows


@lru_cache(maxsize=4)
def joint_functions(problem: RegraspProblem) -> JointFunctions:
    """Return the shared functions of `problem`."""
    cell = problem.workcell
    q, T_target = ca.SX.sym("q", cell.arm.robot.dof), ca.SX.sym("T", 4, 4)
    T = ca.SX(ca.DM(cell.arm.T_world_base)) @ forward_kinematics(cell.arm.robot)(q)
    turn = T_target[:3, :3].T @ T[:3, :3]
    skew = (turn - turn.T) / 2
    rows = ca.vertcat((T[:3, 3] - T_target[:3, 3]) / POSITION_UNIT, skew[2, 1], skew[0, 2], skew[1, 0])
    residual = ca.Function("residual", [q, T_target], [rows], ["q", "T"], ["r"])
    J = flange_jacobian(cell.arm.robot)(q)
    D, _, _ = ca.ldl(ca.densify(J @ J.T + 1e-12 * ca.SX.eye(6)))
    square = D[0] * D[1] * D[2] * D[3] * D[4] * D[5]
    manipulability = ca.Function("manipulability", [q], [ca.sqrt(ca.fmax(square, 1e-16))], ["q"], ["w"])
    return JointFunctions(residual, manipulability, configuration_rows(problem), object_rows(problem))


class JointSolve(NamedTuple):
    """What a solver left: `xi` (N, 3), `q` (N+1, 2, dof), its word for how it ended, and its iterations.

    `violation` says which constraint is violated most and by how much; it is empty where all hold to `FEASIBLE`.
    """

    xi: FloatArray
    q: FloatArray
    status: str
    violation: str
    iterations: int


OPTIONS = ProgramOptions(
    hessian="limited-memory",  # as many iterations as with exact Hessians, and built in a third
    max_iterations=60,
    tolerance=1e-4,
    ipopt=(("constr_viol_tol", 1e-7), ("mu_init", 1e-3)),
)


class JointProgram:
    """One program, from poses at `xi` (N, 3) and a choice of grasps whose configurations satisfy the kinematics.

    Candidates keep to what `check` says, by exact measures; `cost_weight` is the weight of ``J_seq`` in the objective.
    """

    def __init__(
        self, check: CandidateCheck, minimise: Measure, cost_weight: float, xi: FloatArray, choice: JointChoice
    ) -> None:
        problem, robot = check.problem, check.problem.workcell.arm.robot
        self._check, self._minimise, self._weight, self._choice = check, minimise, cost_weight, choice
        self._functions, self._start = joint_functions(problem), check.poses(xi)
        self._reached = not check.bounds.shortfall(check.measured(xi, choice))
        at = problem.rests.planar[check.plan.placements]
        q, nlp = choice.q.reshape(-1, robot.dof), NonlinearProgram()
        self._nlp, self._xi = nlp, nlp.variable("xi", xi.shape, lower=at.low, upper=at.high, guess=xi)
        self._q = nlp.variable("q", q.shape, lower=robot.lower, upper=robot.upper, guess=q)
        self._least = nlp.variable("least", lower=-10.0, upper=10.0)
        poses = [ca.MX(ca.DM(T)) for T in self._start]
        for i, (surface, base) in enumerate(zip(at.surfaces, at.bases, strict=True)):
            poses[i + 1] = ca.MX(ca.DM(surface)) @ planar(self._xi[i, :]) @ ca.MX(ca.DM(base))
        for i, side in np.ndindex(choice.q.shape[:2]):
            self._add_configuration(i, side, poses[i + side])
        clearances = self._functions.object_clearances
        for i, T in enumerate(poses[1:-1], start=1):
            margin = np.array(clearances.function(self._start[i])).ravel()
            names = [f"pose {i}: the clearance of {name}" for name in clearances.names]
            rows = clearances.function(T)
            nlp.add_constraint(f"pose {i}", rows, lower=np.minimum(0.0, margin), labels=names, unit=" m")
        self._add_totals()

    def solve(self, ipopt: dict[str, Any]) -> JointSolve:
        """Return where Ipopt ends, with `ipopt` options over ours; an `OptionError` says which it refuses."""
        solver = self._nlp.solver(replace(OPTIONS, ipopt=(*OPTIONS.ipopt, *ipopt.items())))
        solution = solver.solve(**self._nlp.arguments)
        found, violation = self._nlp.unpack(solution.x), self._nlp.worst_violation(solution.g, FEASIBLE)
        q = found["q"].reshape(self._choice.q.shape)
        return JointSolve(found["xi"], q, solution.status, violation, solution.iterations)

    def _add_configuration(self, i: int, side: int, T: Any) -> None:
        """Add what holds at pick (side 0) or place (side 1) of a transition: kinematics, clearances, manipulability."""
        where, bounds, problem = f"transition {i}, {('pick', 'place')[side]}", self._check.bounds, self._check.problem
        q, grasp_id = self._q[2 * i + side, :].T, self._choice.grasp_ids[i]

        def demand(what: str, rows: Any, low: Any, labels: list[str], scale: float, **rest: Any) -> None:
            named = [f"{where}: {label}" for label in labels]
            self._nlp.add_constraint(f"{where}: {what}", rows, lower=low, labels=named, scale=scale, **rest)

        T_object_flange = problem.grasps.T_object_tcp[grasp_id] @ problem.workcell.arm.end_effector.T_tcp_flange
        residual = self._functions.residual(q, T @ ca.MX(ca.DM(T_object_flange)))
        demand("position", residual[:3], 0.0, ["the position of the grasp"] * 3, POSITION_UNIT, unit=" m", upper=0.0)
        demand("direction", residual[3:], 0.0, ["the direction of the grasp"] * 3, 1.0, unit=" rad", upper=0.0)

        clearances, width = self._functions.clearances, problem.grasps.width[grasp_id]
        margin = np.array(clearances.function(self._choice.q[i, side], self._start[i + side], width)).ravel()
        wanted = np.where(clearances.measured, np.maximum(bounds.clearance - clearances.required, 0.0), 0.0)
        values = clearances.function(q, T, width)
        names = [f"the clearance of {name}" for name in clearances.names]
        low = np.minimum(wanted, margin) if self._reached else np.where(wanted > 0, wanted, np.minimum(margin, 0.0))
        demand("clearances", values, low, names, 1.0, unit=" m")
        if self._minimise == "clearance":
            measured = np.flatnonzero(clearances.measured).tolist()
            rows = (values[measured] + clearances.required[measured]) / CLEARANCE_UNIT - self._least
            demand("least clearance", rows, 0.0, [names[k] for k in measured], CLEARANCE_UNIT, unit=" m")

        manipulability, label = self._functions.manipulability(q) / MANIPULABILITY_UNIT, ["the manipulability"]
        if bounds.manipulability > 0:
            least = bounds.manipulability / MANIPULABILITY_UNIT
            demand("manipulability", manipulability, least, label, MANIPULABILITY_UNIT)
        if self._minimise == "manipulability":
            demand("least manipulability", manipulability - self._least, 0.0, label, MANIPULABILITY_UNIT)

    def _add_totals(self) -> None:
        """Add the bounds on travel and cost, and the objective."""
        nlp, bounds, J_seq = self._nlp, self._check.bounds, self._check.J_seq
        home = [] if self._check.home is None else [ca.MX(ca.DM(self._check.home))]
        path = [*home, *[row.T for row in ca.vertsplit(self._q)], *home]
        legs = [ca.sqrt(ca.sumsqr(b - a) + SMOOTHING**2) for a, b in itertools.pairwise(path)]
        travel = sum(legs[1:], legs[0])
        nlp.add_cost(travel if self._minimise == "travel" else 0.01 * travel - self._least)
        if np.isfinite(bounds.travel):
            nlp.add_constraint("the joint travel", travel, upper=bounds.travel, unit=" rad")
        if J_seq is not None and (self._weight > 0 or np.isfinite(bounds.cost)):
            cost = J_seq(self._xi)
            nlp.add_cost(self._weight * cost)
            if np.isfinite(bounds.cost):
                nlp.add_constraint("the cost J_seq", cost, upper=bounds.cost)


def planar(xi: Any) -> Any:
    """Return ``dT(xi)`` (4, 4) of one pose's planar parameters (3,) (Eq. 6)."""
    c, s = ca.cos(xi[2]), ca.sin(xi[2])
    T = ca.MX.eye(4)
    T[0, 0], T[0, 1], T[1, 0], T[1, 1] = c, -s, s, c
    T[0, 3], T[1, 3] = xi[0], xi[1]
    return T
