"""A pick-and-place as an optimal control problem: the arm moves fast to where the next grasp is likely.

The bottle must be put down once on its way to the goal. Direct transcription in CasADi: joint accelerations are
piecewise constant, the time is free, and the hand ends where it puts the bottle down at planar parameters `xi`, which
are free as well. The cost is the time plus a weight times `Q_pair` of both moves. A table shows what each weight
costs in time and buys in grasps that the put-down pose really shares with start and goal:
`python examples/08_pick_and_place.py`.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.connectivity import exact_energy
from regrasp_opt.robots.casadi_kinematics import forward_kinematics

STEPS = 30
"""Intervals of the transcription."""
LIFT = 0.08
"""How far the hand stays above pick and place in the middle half of the motion [m]."""
ACCELERATION = 5.0
"""Largest joint acceleration [rad/s^2]."""
WEIGHTS = (0.0, 0.02, 0.2)


class Outcome(NamedTuple):
    xi: np.ndarray
    duration: float
    score: float


def object_pose(xi: ca.MX, placement: np.ndarray) -> ca.MX:
    """Return ``dT(xi) @ placement`` (4, 4), Eq. 6."""
    R = ca.blockcat([[ca.cos(xi[2]), -ca.sin(xi[2])], [ca.sin(xi[2]), ca.cos(xi[2])]])
    planar = ca.diagcat(R, 1, 1)
    planar[:2, 3] = xi[:2]
    return planar @ placement


def carry(plan: RegraspPlan, weight: float) -> Outcome:
    """Carry the object from the start to a pose near the plan's first, in little time and with a low `Q_pair`."""
    problem, transition = plan.problem, plan.transitions[0]
    robot, effector = problem.workcell.robot, problem.workcell.end_effector
    best = int(transition.clearance.argmax())
    T_object_flange = problem.grasps.T_object_tcp[transition.grasp_ids[best]] @ effector.T_tcp_flange
    ends = [exact_energy(problem.feasible_grasps(T)) for T in plan.poses[[0, -1]]]
    functions = problem.energy.casadi_functions(start=ends[0], goal=ends[1], placements=plan.placements[:1])

    opti = ca.Opti()
    q, v = opti.variable(robot.dof, STEPS + 1), opti.variable(robot.dof, STEPS + 1)
    a, duration, xi = opti.variable(robot.dof, STEPS), opti.variable(), opti.variable(3)
    h = duration / STEPS
    opti.subject_to(v[:, 1:] == v[:, :-1] + h * a)
    opti.subject_to(q[:, 1:] == q[:, :-1] + h * v[:, :-1] + h**2 / 2 * a)
    for j in range(robot.dof):
        opti.subject_to(opti.bounded(robot.lower[j], q[j, :], robot.upper[j]))
        opti.subject_to(opti.bounded(-robot.velocity_limits[j], v[j, :], robot.velocity_limits[j]))
        opti.subject_to(opti.bounded(-ACCELERATION, a[j, :], ACCELERATION))
    opti.subject_to(opti.bounded(0.2, duration, 10.0))

    kinematics = forward_kinematics(robot)

    def pose(configuration: ca.MX) -> ca.MX:
        return problem.workcell.T_world_base @ kinematics(configuration)

    opti.subject_to(q[:, 0] == transition.q_pick[best])
    opti.subject_to(v[:, 0] == 0)
    opti.subject_to(v[:, -1] == 0)
    last, wanted = pose(q[:, -1]), object_pose(xi, problem.placement_poses[plan.placements[0]]) @ T_object_flange
    opti.subject_to(last[:3, 3] == wanted[:3, 3])
    opti.subject_to(sum(ca.cross(last[:3, i], wanted[:3, i]) for i in range(3)) == 0)
    for k in range(STEPS // 4, 3 * STEPS // 4 + 1):
        for end in (0, STEPS):
            opti.subject_to(pose(q[:, k])[2, 3] >= pose(q[:, end])[2, 3] + LIFT)
    low, high = problem.workcell.bounds.array
    opti.subject_to(opti.bounded(low, xi[:2], high))

    score = ca.sum1(functions.Q_pair(xi.T))
    opti.minimize(duration + weight * score + 1e-4 * ca.sumsqr(a) / STEPS)
    opti.set_initial(xi, plan.xi[0])
    opti.set_initial(duration, 2.0)
    opti.set_initial(q, np.linspace(transition.q_pick[best], transition.q_place[best], STEPS + 1).T)
    opti.solver("ipopt", {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 300}})
    found = opti.solve()
    return Outcome(np.array(found.value(xi)), float(found.value(duration)), float(found.value(score)))


def main() -> None:
    problem = RegraspProblem.load("bottle", "nova2-w")
    start, goal = problem.pose(0, 0.30, 0.30, 0.5), problem.pose(2, -0.28, 0.38, 1.0)
    plan = solve_sequence(problem, start, goal)
    print(f"{'weight':>7}{'time [s]':>10}{'Q_pair':>9}{'x [m]':>9}{'y [m]':>9}{'yaw':>7}   shared grasps of each move")
    for weight in WEIGHTS:
        xi, duration, score = carry(plan, weight)
        middle = problem.pose(plan.placements[0], *xi)
        feasible = np.array([problem.feasible_grasps(T) for T in (start, middle, goal)])
        shared = (feasible[:-1] & feasible[1:]).sum(axis=1)
        place = "".join(f"{value:>9.3f}" for value in xi[:2])
        print(f"{weight:>7}{duration:>10.2f}{score:>9.3f}{place}{xi[2]:>7.2f}   {shared}")


if __name__ == "__main__":
    main()
