"""From a mesh, a robot and a workcell of your own to a page that shows a plan.

Writes a bracket (STL), a six-axis arm (URDF) and a workcell with a shelf (TOML) into the current folder, plans, and
writes own_plan.html: `python examples/02_own_mesh_and_robot.py`. The first plan trains the energy of the arm, for any
object; it is kept for the next ones.
"""

from pathlib import Path

import trimesh

from regrasp_opt import RegraspProblem, load_object, load_workcell, solve_sequence
from regrasp_opt.viz import write_plan_page

# Each joint's height above the one before it and its axis, then the radius and length of the link's body above it [m].
JOINTS = (
    (0.18, "0 0 1", 0.050, 0.10),
    (0.12, "0 1 0", 0.045, 0.30),
    (0.30, "0 1 0", 0.040, 0.10),
    (0.14, "0 0 1", 0.040, 0.12),
    (0.16, "0 1 0", 0.035, 0.04),
    (0.09, "0 0 1", 0.030, 0.01),
)

WORKCELL = """
schema = 1

[robot]
model = "arm.urdf"
tip = "link6"
home = [1.5708, 0.2, 1.6, 0.0, 1.3416, 0.0]

[end_effector]
model = "w"

[table]
center = [0.0, 0.35]
size = [1.4, 1.2]

[workspace]
x = [-0.35, 0.35]
y = [0.20, 0.50]

[[obstacles]]
type = "box"
name = "shelf"
position = [0.0, 0.75, 0.15]
size = [0.6, 0.1, 0.3]
"""


def link(number: int, radius: float, length: float) -> str:
    return f"""
  <link name="link{number}">
    <collision>
      <origin xyz="0 0 {length / 2}"/>
      <geometry><cylinder radius="{radius}" length="{length}"/></geometry>
    </collision>
  </link>"""


def joint(number: int, height: float, axis: str) -> str:
    return f"""
  <joint name="joint{number}" type="revolute">
    <parent link="link{number - 1}"/>
    <child link="link{number}"/>
    <origin xyz="0 0 {height}"/>
    <axis xyz="{axis}"/>
    <limit lower="-3.1" upper="3.1" velocity="2.0" effort="50"/>
  </joint>"""


def write_files() -> None:
    foot = trimesh.creation.box(bounds=[[0.00, 0.00, 0.00], [0.10, 0.05, 0.02]])
    wall = trimesh.creation.box(bounds=[[0.00, 0.00, 0.00], [0.02, 0.05, 0.08]])
    trimesh.boolean.union([foot, wall], engine="manifold").export("bracket.stl")
    parts = [link(0, 0.06, 0.12)]
    for number, (height, axis, radius, length) in enumerate(JOINTS, start=1):
        parts += [link(number, radius, length), joint(number, height, axis)]
    Path("arm.urdf").write_text(f'<robot name="arm">{"".join(parts)}\n</robot>\n', encoding="utf-8")
    Path("cell.toml").write_text(WORKCELL, encoding="utf-8")


def main() -> None:
    write_files()
    bracket, cell = load_object("bracket.stl"), load_workcell("cell.toml")
    print(f"{bracket.name}: {len(bracket.placements)} stable placements")
    print(f"{cell.robot.name}: {cell.robot.dof} joints, inverse kinematics by {type(cell.robot.ik).__name__}")

    problem = RegraspProblem.load(bracket, cell)
    plan = solve_sequence(problem, problem.pose(0, -0.20, 0.35), problem.pose(2, 0.20, 0.30, 1.5))
    print(f"{plan.status.name}: {plan.num_regrasps} regrasp(s)")
    write_plan_page(plan, "own_plan.html")
    print("written: own_plan.html")


if __name__ == "__main__":
    main()
