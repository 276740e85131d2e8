"""The same tasks by the paper's Langevin dynamics, by Ipopt, and by the lattice alone, as a table.

All three prove what they return; they differ in where candidates come from and how they are refined:
`python examples/03_langevin_against_ipopt.py [TASKS]`.
"""

import sys

import numpy as np

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.planning.tasks import random_task

REFINERS = ("ipopt", "lattice", "langevin")


def main(count: int = 5) -> None:
    problem = RegraspProblem.load("bottle", "nova2-w")
    rng = np.random.default_rng(0)
    tasks = [random_task(problem, rng, needs_regrasp=True) for _ in range(count)]
    first = tasks[0]
    solve_sequence(problem, first.start, first.goal)  # builds what later plans share
    print(f"{count} tasks that need a regrasp\n")
    print(f"{'refiner':10}{'solved':>8}{'regrasps':>10}{'J_seq':>9}{'seconds':>9}")
    for refiner in REFINERS:
        plans = [solve_sequence(problem, task.start, task.goal, refiner) for task in tasks]
        solved = [plan for plan in plans if plan.solved]
        regrasps = np.mean([plan.num_regrasps for plan in solved])
        cost = np.median([plan.cost for plan in solved])
        seconds = np.median([plan.timings["total"] for plan in plans])
        print(f"{refiner:10}{len(solved):>5}/{count}{regrasps:>10.1f}{cost:>9.3f}{seconds:>9.2f}")
    print("\nJ_seq and seconds are medians; a lower J_seq promises more shared grasps.")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
