"""Plan with the built-in bottle and print what the robot does: `python examples/01_plan.py`."""

import numpy as np

from regrasp_opt import RegraspProblem, solve_sequence

problem = RegraspProblem.load(object="bottle", workcell="nova2-w")
start = problem.pose(0, -0.25, 0.40, np.radians(30))
goal = problem.pose(1, 0.28, 0.38, np.radians(120))
plan = solve_sequence(problem, start, goal)

print(f"{plan.status.name}: {plan.num_regrasps} regrasp(s) in {plan.timings['total']:.2f} s")
for i, transition in enumerate(plan.transitions):
    best = transition.clearance.argmax()
    print(f"move {i}: grasp {transition.grasp_ids[best]} of {len(transition.grasp_ids)} shared ones")
    print("  pick  at joints", transition.q_pick[best].round(2), "rad")
    print("  place at joints", transition.q_place[best].round(2), "rad")
print("verified again:", plan.residuals().hold)
