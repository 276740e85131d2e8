"""`J_seq` inside an optimisation problem over joint angles: put the object down where the arm travels least.

The variables are the joint configurations that put the object down and pick it up again. The object's pose comes out of
the arm's kinematics, a CasADi function, and `J_seq` scores it. A table shows what the weight of joint travel buys, and
how many grasps are really shared: `python examples/06_joint_travel_in_opti.py`.
"""

import itertools

import casadi as ca
import numpy as np
from scipy.linalg import null_space

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.connectivity import exact_energy
from regrasp_opt.robots.casadi_kinematics import forward_kinematics

WEIGHTS = (0.0, 0.003, 0.01, 0.03, 0.1)


def best_grasps(plan: RegraspPlan) -> tuple[list[int], np.ndarray]:
    """Return one grasp for each of the two moves and the four joint configurations, those that travel least."""
    first, second = plan.transitions

    def configurations(i: int, k: int) -> np.ndarray:
        return np.array([first.q_pick[i], first.q_place[i], second.q_pick[k], second.q_place[k]])

    pairs = itertools.product(range(len(first.grasp_ids)), range(len(second.grasp_ids)))
    i, k = min(pairs, key=lambda pair: np.square(np.diff(configurations(*pair), axis=0)).sum())
    return [first.grasp_ids[i], second.grasp_ids[k]], configurations(i, k)


def shortened(
    plan: RegraspPlan, grasps: list[int], q: np.ndarray, weight: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return configurations (4, dof) near `q` that trade `J_seq` for travel, the object's pose (4, 4), and `J_seq`."""
    problem, cell = plan.problem, plan.problem.workcell
    forward = forward_kinematics(cell.robot)

    def object_pose(q, grasp):
        T_object_flange = problem.grasps.T_object_tcp[grasp] @ cell.end_effector.T_tcp_flange
        return ca.DM(cell.T_world_base) @ forward(q) @ ca.DM(np.linalg.inv(T_object_flange))

    J_seq = problem.energy.casadi_pose_functions(
        num_poses=1,
        start=exact_energy(problem.feasible_grasps(plan.poses[0])),
        goal=exact_energy(problem.feasible_grasps(plan.poses[-1])),
        blocked=problem.ruled_out(plan.placements, plan.xi),
    ).J_seq

    opti = ca.Opti()
    place, pick = opti.variable(cell.robot.dof), opti.variable(cell.robot.dof)
    T, T_again = object_pose(place, grasps[0]), object_pose(pick, grasps[1])
    travel = ca.sumsqr(place - q[0]) + ca.sumsqr(pick - place) + ca.sumsqr(q[3] - pick)
    score = J_seq(T)
    opti.minimize(score + weight * travel)

    lying = problem.placement_poses[plan.placements[0]]  # the object lies on the table in its stable placement
    opti.subject_to(T[2, :3] @ null_space(lying[2:3, :3]) == 0)
    opti.subject_to(T[2, 3] == lying[2, 3])
    turn = T[:3, :3].T @ T_again[:3, :3]  # the next grasp takes it where it lies
    opti.subject_to(T[:3, 3] == T_again[:3, 3])
    opti.subject_to(ca.vertcat(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]) == 0)
    low, high = cell.bounds.array
    center = T @ np.append(problem.object.center_of_mass, 1.0)
    opti.subject_to(opti.bounded(low, center[:2], high))
    for angles in (place, pick):
        opti.subject_to(opti.bounded(cell.robot.lower, angles, cell.robot.upper))

    opti.set_initial(place, q[1])
    opti.set_initial(pick, q[2])
    opti.solver("ipopt", {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}})
    found = opti.solve()
    return np.array([q[0], found.value(place), found.value(pick), q[3]]), found.value(T), found.value(score)


def main() -> None:
    problem = RegraspProblem.load("bottle", "nova2-w")
    start, goal = problem.pose(0, -0.25, 0.40, 0.5), problem.pose(1, 0.28, 0.38, 2.1)
    plan = solve_sequence(problem, start, goal)
    grasps, q = best_grasps(plan)
    print(f"the plan's least travel is {np.linalg.norm(np.diff(q, axis=0), axis=1).sum():.2f} rad\n")
    print(f"{'weight':>7}{'travel [rad]':>14}{'J_seq':>9}   shared grasps of each move   the two grasps hold")
    for weight in WEIGHTS:
        q, T, score = shortened(plan, grasps, q, weight)  # from the last solution: small steps keep to one valley
        feasible = np.array([problem.feasible_grasps(pose) for pose in (start, T, goal)])
        shared = (feasible[:-1] & feasible[1:]).sum(axis=1)
        travel = np.linalg.norm(np.diff(q, axis=0), axis=1).sum()
        print(f"{weight:>7}{travel:>14.2f}{score:>9.3f}   {shared!s:<27} {bool(feasible[1, grasps].all())}")


if __name__ == "__main__":
    main()
