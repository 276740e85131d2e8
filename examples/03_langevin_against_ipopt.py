"""The same tasks by every refiner that comes with the package, as a table and as a plot.

All verify what they return; they differ in where candidates come from and how they are refined. "paper" gives up where
the one candidate that it accepts does not hold, and "exact" does without an energy. The plot,
langevin_against_ipopt.html, shows the cost by iteration of both refiners from the same random starts on one task:
`python examples/03_langevin_against_ipopt.py [TASKS]`.
"""

import sys

import numpy as np
import plotly.graph_objects as go

from regrasp_opt import CostOptions, RegraspProblem, solve_sequence
from regrasp_opt.connectivity import SequenceObjective, exact_energy
from regrasp_opt.planning.tasks import Task, random_task
from regrasp_opt.solvers import LangevinRefiner, NlpRefiner, random_starts

REFINERS = ("ipopt", "lattice", "langevin", "langevin-ipopt", "paper", "exact")
STARTS = 8


def write_plot(problem: RegraspProblem, task: Task, path: str) -> None:
    ends = [exact_energy(problem.feasible_grasps(T)) for T in (task.start, task.goal)]
    objective = SequenceObjective(problem.energy, problem.rests.planar, *ends, CostOptions())
    starts = random_starts(objective, 1, STARTS, np.random.default_rng(0))
    figure = go.Figure()
    for refiner, color in ((LangevinRefiner(), "orange"), (NlpRefiner(), "teal")):
        refined = refiner.refine(objective, starts, np.random.default_rng(0))
        for number, trace in enumerate(refined.traces):
            line = go.Scatter(y=trace, name=refiner.name, line={"color": color}, showlegend=number == 0)
            figure.add_trace(line)
        print(f"{refiner.name:10} best of {STARTS} random starts: J_seq = {refined.candidates.cost.min():.3f}")
    figure.update_layout(xaxis_title="iteration", yaxis_title="J_seq")
    figure.write_html(path)
    print(f"written: {path}")


def main(count: int = 5) -> None:
    problem = RegraspProblem.load("bottle", "nova2-w")
    rng = np.random.default_rng(0)
    tasks = [random_task(problem, rng, needs_regrasp=True) for _ in range(count)]
    first = tasks[0]
    solve_sequence(problem, first.start, first.goal)  # builds what later plans share
    print(f"{count} tasks that need a regrasp\n")
    print(f"{'refiner':14}{'solved':>8}{'regrasps':>10}{'J_seq':>9}{'seconds':>9}")
    for refiner in REFINERS:
        plans = [solve_sequence(problem, task.start, task.goal, refiner) for task in tasks]
        solved = [plan for plan in plans if plan.solved]
        if not solved:
            print(f"{refiner:14}    0/{count}")
            continue
        regrasps = np.mean([plan.num_regrasps for plan in solved])
        cost = np.median([plan.cost for plan in solved])
        seconds = np.median([plan.timings["total"] for plan in plans])
        print(f"{refiner:14}{len(solved):>5}/{count}{regrasps:>10.1f}{cost:>9.3f}{seconds:>9.2f}")
    print("\nJ_seq and seconds are medians; a lower J_seq promises more shared grasps.\n")
    write_plot(problem, first, "langevin_against_ipopt.html")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
