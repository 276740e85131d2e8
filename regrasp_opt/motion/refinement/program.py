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
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.conventions import FloatArray, planar_transform
from regrasp_opt.motion.refinement.bodies import Rows, configuration_rows, object_rows
from regrasp_opt.motion.refinement.measures import Measure, MeasureBounds
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

    Attributes
    ----------
    residual : casadi.Function
        Kinematic residual (6, 1) of ``q`` (dof,) and the flange wanted, ``T`` (4, 4) T_world_flange, and its Jacobian
        in q (6, dof).
    manipulability : casadi.Function
        Of ``q``.
    clearances : Rows
        Of arm and gripper at ``q`` with the object at ``T``.
    object_clearances : Rows
        Of the object at ``T``.
    """

    residual: Any
    manipulability: Any
    clearances: Rows
    object_clearances: Rows


def joint_functions(problem: RegraspProblem) -> JointFunctions:
    """Return the shared functions of `problem`."""
    cell = problem.workcell
    q, T_target = ca.SX.sym("q", cell.arm.robot.dof), ca.SX.sym("T", 4, 4)
    T = ca.SX(ca.DM(cell.arm.T_world_base)) @ forward_kinematics(cell.arm.robot)(q)
    turn = T_target[:3, :3].T @ T[:3, :3]
    skew = (turn - turn.T) / 2
    rows = ca.vertcat((T[:3, 3] - T_target[:3, 3]) / POSITION_UNIT, skew[2, 1], skew[0, 2], skew[1, 0])
    residual = ca.Function("residual", [q, T_target], [rows, ca.jacobian(rows, q)], ["q", "T"], ["r", "J"])
    J = flange_jacobian(cell.arm.robot)(q)
    D, _, _ = ca.ldl(ca.densify(J @ J.T + 1e-12 * ca.SX.eye(6)))
    square = D[0] * D[1] * D[2] * D[3] * D[4] * D[5]
    manipulability = ca.Function("manipulability", [q], [ca.sqrt(ca.fmax(square, 1e-16))], ["q"], ["w"])
    return JointFunctions(residual, manipulability, configuration_rows(problem), object_rows(problem))


class JointTask(NamedTuple):
    """One program: what is minimised within which bounds, and where it starts.

    Attributes
    ----------
    placements : (N, 4, 4)
        Stable placement of each intermediate pose, T_world_object at xi = 0.
    ends : (2, 4, 4)
        Start and goal.
    T_object_flange : (N+1, 4, 4)
        The flange of the chosen grasp of each transition.
    width : (N+1,)
        Their jaw widths [m].
    xi : (N, 3)
        Where the poses start.
    q : (N+1, 2, dof)
        Where the configurations start; they satisfy the kinematics.
    minimise : Measure
    bounds : MeasureBounds
        Bounds on the other measures.
    home : (dof,) or None
        Where the arm starts and ends.
    cost : casadi.Function or None
        ``J_seq`` as a function of ``xi`` (N, 3).
    cost_weight : float
        Weight of ``J_seq`` in the objective.
    reached : bool
        Whether the start keeps to the bounds, by exact measures.
    """

    placements: FloatArray
    ends: FloatArray
    T_object_flange: FloatArray
    width: FloatArray
    xi: FloatArray
    q: FloatArray
    minimise: Measure
    bounds: MeasureBounds
    home: FloatArray | None
    cost: Any
    cost_weight: float
    reached: bool

    def poses(self, xi: FloatArray) -> FloatArray:
        """Return all poses (N+2, 4, 4) at planar parameters `xi` (N, 3) (Eq. 6)."""
        return np.concatenate([self.ends[:1], planar_transform(xi) @ self.placements, self.ends[1:]])


class JointSolve(NamedTuple):
    """What a solver left.

    Attributes
    ----------
    xi : (N, 3)
    q : (N+1, 2, dof)
    status : str
        The solver's word for how it ended.
    violation : str
        Which constraint is violated most and by how much; empty where all hold to `FEASIBLE`.
    iterations : int
    """

    xi: FloatArray
    q: FloatArray
    status: str
    violation: str
    iterations: int


def solve_joint(
    problem: RegraspProblem, functions: JointFunctions, task: JointTask, ipopt: dict[str, Any]
) -> JointSolve:
    """Solve the program of `task` with Ipopt, with `ipopt` options over ours.

    Raises
    ------
    OptionError
        If Ipopt refuses an option.
    """
    robot, size = problem.workcell.arm.robot, len(task.xi)
    low, high = ([*side, e] for side, e in zip(problem.workcell.bounds.array, (-np.inf, np.inf), strict=True))
    nlp = NonlinearProgram()
    xi = nlp.variable("xi", (size, 3), lower=low, upper=high, guess=task.xi)
    q = nlp.variable(
        "q", (2 * size + 2, robot.dof), lower=robot.lower, upper=robot.upper, guess=task.q.reshape(-1, robot.dof)
    )
    least = nlp.variable("least", lower=-10.0, upper=10.0)
    poses = [ca.MX(ca.DM(task.ends[0]))]
    poses += [planar(xi[i, :]) @ ca.MX(ca.DM(T)) for i, T in enumerate(task.placements)]
    poses += [ca.MX(ca.DM(task.ends[1]))]
    for i in range(size + 1):
        for side in (0, 1):
            _add_configuration(nlp, functions, task, (i, side), q[2 * i + side, :].T, poses[i + side], least)
    for i, T in enumerate(poses[1:-1], start=1):
        margin = np.array(functions.object_clearances.function(task.poses(task.xi)[i])).ravel()
        names = [f"pose {i}: the clearance of {name}" for name in functions.object_clearances.names]
        rows = functions.object_clearances.function(T)
        nlp.add_constraint(f"pose {i}", rows, lower=np.minimum(0.0, margin), labels=names, unit=" m")
    _add_totals(nlp, task, xi, q, least)
    solution = nlp.solver(replace(OPTIONS, ipopt=(*OPTIONS.ipopt, *ipopt.items()))).solve(**nlp.arguments)
    found = nlp.unpack(solution.x)
    violation = nlp.worst_violation(solution.g, FEASIBLE)
    return JointSolve(found["xi"], found["q"].reshape(task.q.shape), solution.status, violation, solution.iterations)


OPTIONS = ProgramOptions(
    hessian="limited-memory",  # as many iterations as with exact Hessians, and built in a third
    max_iterations=60,
    tolerance=1e-4,
    ipopt=(("constr_viol_tol", 1e-7), ("mu_init", 1e-3)),
)


def _add_configuration(
    nlp: NonlinearProgram,
    functions: JointFunctions,
    task: JointTask,
    which: tuple[int, int],
    q: Any,
    T: Any,
    least: Any,
) -> None:
    """Add what holds at pick (side 0) or place (side 1) of a transition: kinematics, clearances, manipulability."""
    i, side = which
    where = f"transition {i}, {('pick', 'place')[side]}"

    def demand(
        what: str, rows: Any, low: Any, labels: list[str], scale: float, unit: str = "", high: float = np.inf
    ) -> None:
        labels = [f"{where}: {label}" for label in labels]
        nlp.add_constraint(f"{where}: {what}", rows, lower=low, upper=high, labels=labels, scale=scale, unit=unit)

    residual, _ = functions.residual(q, T @ ca.MX(ca.DM(task.T_object_flange[i])))
    demand("position", residual[:3], 0.0, ["the position of the grasp"] * 3, POSITION_UNIT, " m", high=0.0)
    demand("direction", residual[3:], 0.0, ["the direction of the grasp"] * 3, 1.0, " rad", high=0.0)

    clearances, floor = functions.clearances, task.bounds.clearance
    start = task.poses(task.xi)[i + side]
    margin = np.array(clearances.function(task.q[i, side], start, task.width[i])).ravel()
    wanted = np.where(clearances.measured, np.maximum(floor - clearances.required, 0.0), 0.0)
    values = clearances.function(q, T, task.width[i])
    names = [f"the clearance of {name}" for name in clearances.names]
    low = np.minimum(wanted, margin) if task.reached else np.where(wanted > 0, wanted, np.minimum(margin, 0.0))
    demand("clearances", values, low, names, 1.0, " m")
    if task.minimise == "clearance":
        measured = np.flatnonzero(clearances.measured).tolist()
        rows = (values[measured] + clearances.required[measured]) / CLEARANCE_UNIT - least
        demand("least clearance", rows, 0.0, [names[k] for k in measured], CLEARANCE_UNIT, " m")

    manipulability, label = functions.manipulability(q) / MANIPULABILITY_UNIT, ["the manipulability"]
    if task.bounds.manipulability > 0:
        low = task.bounds.manipulability / MANIPULABILITY_UNIT
        demand("manipulability", manipulability, low, label, MANIPULABILITY_UNIT)
    if task.minimise == "manipulability":
        demand("least manipulability", manipulability - least, 0.0, label, MANIPULABILITY_UNIT)


def _add_totals(nlp: NonlinearProgram, task: JointTask, xi: Any, q: Any, least: Any) -> None:
    """Add the bounds on travel and cost, and the objective."""
    home = [] if task.home is None else [ca.MX(ca.DM(task.home))]
    path = [*home, *[row.T for row in ca.vertsplit(q)], *home]
    legs = [ca.sqrt(ca.sumsqr(b - a) + SMOOTHING**2) for a, b in itertools.pairwise(path)]
    travel = sum(legs[1:], legs[0])
    nlp.add_cost(travel if task.minimise == "travel" else 0.01 * travel - least)
    if np.isfinite(task.bounds.travel):
        nlp.add_constraint("the joint travel", travel, upper=task.bounds.travel, unit=" rad")
    if task.cost is not None and (task.cost_weight > 0 or np.isfinite(task.bounds.cost)):
        cost = task.cost(xi)
        nlp.add_cost(task.cost_weight * cost)
        if np.isfinite(task.bounds.cost):
            nlp.add_constraint("the cost J_seq", cost, upper=task.bounds.cost)


def planar(xi: Any) -> Any:
    """Return ``dT(xi)`` (4, 4) of one pose's planar parameters (3,) (Eq. 6)."""
    c, s = ca.cos(xi[2]), ca.sin(xi[2])
    T = ca.MX.eye(4)
    T[0, 0], T[0, 1], T[1, 0], T[1, 1] = c, -s, s, c
    T[0, 3], T[1, 3] = xi[0], xi[1]
    return T
