"""`J_seq` with its gradient as C code, minimised by a loop that knows nothing of Python.

Writes jseq.c into the current folder, compiles it together with 07_export_to_c.c by the system's C compiler, and lets
the program improve a pose of the lattice; Ipopt's result stands beside it: `python examples/07_export_to_c.py`.
"""

import subprocess
from pathlib import Path

import casadi as ca
import numpy as np

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.connectivity import exact_energy


def write_code(plan: RegraspPlan) -> None:
    """Write the C function `jseq`: planar parameters (3, 1) to `J_seq` and its gradient (3, 1)."""
    problem = plan.problem
    ends = [exact_energy(problem.feasible_grasps(T)) for T in plan.poses[[0, -1]]]
    J_seq = problem.energy.casadi_functions(
        start=ends[0],
        goal=ends[1],
        placements=plan.placements,
        blocked=problem.ruled_out(plan.placements, plan.xi),
        blas="reference",
    ).J_seq
    xi = ca.MX.sym("xi", 1, 3)
    cost = J_seq(xi)
    code = ca.CodeGenerator("jseq.c", {"with_header": True})
    code.add(ca.Function("jseq", [xi], [cost, ca.gradient(cost, xi)], ["xi"], ["J", "gradient"]))
    code.generate()


def main() -> None:
    problem = RegraspProblem.load("bottle", "nova2-w")
    start, goal = problem.pose(2, -0.25, 0.40, 0.5), problem.pose(4, 0.28, 0.38, 2.1)
    plan = solve_sequence(problem, start, goal, "lattice")
    write_code(plan)
    loop = Path(__file__).with_suffix(".c")
    subprocess.run(["cc", "-std=c99", "-O2", "-I.", "-o", "descend", str(loop), "jseq.c", "-lm"], check=True)
    arguments = [*plan.xi[0], *problem.workcell.bounds.array.ravel()]
    done = subprocess.run(["./descend", *map(repr, map(float, arguments))], check=True, capture_output=True, text=True)
    print(done.stdout, end="")
    found = problem.nlp(start, goal, placements=plan.placements, guess=plan.xi).solve()
    print(f"Ipopt from the same pose: J_seq = {found.f:.4f} at {np.round(found.x, 4)}")


if __name__ == "__main__":
    main()
