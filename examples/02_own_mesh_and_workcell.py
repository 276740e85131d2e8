"""From a mesh and a workcell file of your own to a page that shows a plan.

Writes a bracket (STL) and a workcell with a shelf (TOML) into the present folder, prepares a small model for the two,
plans, and writes own_plan.html: `python examples/02_own_mesh_and_workcell.py`.
"""

from pathlib import Path

import trimesh

from regrasp_opt import RegraspProblem, load_object, load_workcell, prepare, solve_sequence
from regrasp_opt.viz import write_plan_page

WORKCELL = """
schema = 1

[robot]
model = "nova2"

[end_effector]
model = "w"

[table]
center = [0.0, 0.35]
size = [1.4, 1.2]

[workspace]
x = [-0.40, 0.40]
y = [0.15, 0.55]

[[obstacles]]
type = "box"
name = "shelf"
position = [0.0, 0.75, 0.15]
size = [0.6, 0.1, 0.3]
"""


def write_files() -> None:
    foot = trimesh.creation.box(bounds=[[0.00, 0.00, 0.00], [0.10, 0.05, 0.02]])
    wall = trimesh.creation.box(bounds=[[0.00, 0.00, 0.00], [0.02, 0.05, 0.08]])
    trimesh.boolean.union([foot, wall], engine="manifold").export("bracket.stl")
    Path("cell.toml").write_text(WORKCELL, encoding="utf-8")


def main() -> None:
    write_files()
    bracket, cell = load_object("bracket.stl"), load_workcell("cell.toml")
    print(f"{bracket.name}: {len(bracket.placements)} stable placements")

    folder, report = prepare(bracket, cell, samples=3000)  # the default of 20,000 gives a better energy
    print(f"{report['grasps']} grasps, average precision {report['held_out']['default']['average_precision']:.3f}")

    problem = RegraspProblem.load(bracket, cell, model=folder)
    plan = solve_sequence(problem, problem.pose(0, -0.20, 0.35), problem.pose(2, 0.20, 0.30, 1.5))
    print(f"{plan.status.name}: {plan.num_regrasps} regrasp(s)")
    write_plan_page(plan, "own_plan.html")
    print("written: own_plan.html")


if __name__ == "__main__":
    main()
