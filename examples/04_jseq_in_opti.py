"""`J_seq` inside an optimisation problem of your own: put the object down where a camera sees it.

A CasADi `Opti` problem minimises `J_seq` plus the squared distance of the intermediate poses to a place of choice. A
table shows how the pose moves there as the weight grows, and how many grasps are really shared:
`python examples/04_jseq_in_opti.py`.
"""

import casadi as ca
import numpy as np

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.connectivity import exact_energy

CAMERA = np.array([0.35, 0.50])
WEIGHTS = (0.0, 1.0, 5.0, 10.0, 100.0)


def pulled(plan: RegraspPlan, guess: np.ndarray, weight: float) -> np.ndarray:
    """Return planar parameters (N, 3) near `guess` that trade `J_seq` for nearness to the camera's place."""
    problem = plan.problem
    ends = [exact_energy(problem.feasible_grasps(T)) for T in plan.poses[[0, -1]]]
    functions = problem.energy.casadi_functions(start=ends[0], goal=ends[1], placements=plan.placements)
    opti = ca.Opti()
    xi = opti.variable(plan.num_regrasps, 3)
    away = ca.sumsqr(xi[:, :2] - ca.repmat(CAMERA[None], plan.num_regrasps, 1))
    opti.minimize(functions.J_seq(xi) + weight * away)
    low, high = problem.workcell.bounds.array
    for i in range(plan.num_regrasps):
        opti.subject_to(opti.bounded(low, xi[i, :2].T, high))
    opti.set_initial(xi, guess)
    opti.solver("ipopt", {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}})
    return np.reshape(opti.solve().value(xi), (-1, 3))


def main() -> None:
    problem = RegraspProblem.load("bottle", "nova2-w")
    start, goal = problem.pose(0, -0.25, 0.40, 0.5), problem.pose(1, 0.28, 0.38, 2.1)
    plan = solve_sequence(problem, start, goal)
    print(f"the plan alone puts the bottle down at {plan.xi[0, :2].round(3)}\n")
    print(f"{'weight':>7}{'x [m]':>9}{'y [m]':>9}{'away [m]':>10}   shared grasps of each move")
    xi = plan.xi
    for weight in WEIGHTS:
        xi = pulled(plan, xi, weight)  # from the last solution: small steps keep to one valley
        middle = [problem.pose(m, *p) for m, p in zip(plan.placements, xi, strict=True)]
        feasible = np.array([problem.feasible_grasps(T) for T in (start, *middle, goal)])
        shared = (feasible[:-1] & feasible[1:]).sum(axis=1)
        away = np.linalg.norm(xi[0, :2] - CAMERA)
        print(f"{weight:>7.0f}{xi[0, 0]:>9.3f}{xi[0, 1]:>9.3f}{away:>10.3f}   {shared}")


if __name__ == "__main__":
    main()
