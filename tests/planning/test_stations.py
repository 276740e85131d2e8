"""Plans over several supports: rests, lattice, programs and certificate on level and tilted boards and in a fixture."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp_opt.connectivity import CostOptions
from regrasp_opt.conventions import pose_distance, rotation_rpy, translation
from regrasp_opt.errors import PoseError, UnknownNameError, WorkcellError
from regrasp_opt.geometry.shapes import shape_geometry
from regrasp_opt.geometry.solids import Solid, separation
from regrasp_opt.motion import plan_motion
from regrasp_opt.motion.trajectory.collision_context import MotionScene
from regrasp_opt.planning import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.pose_text import describe_pose, parse_pose
from regrasp_opt.planning.tasks import random_graspable_pose, random_task
from regrasp_opt.solvers.landscape import NumPyLandscape

CELL = """
schema = 2

[[arms]]
name = "left"
robot = "nova2"
end_effector = "w"

[[supports]]
name = "table"
center = [0.0, 0.35]
size = [1.0, 0.7]
workspace = { x = [-0.40, 0.05], y = [0.15, 0.55] }

[[supports]]
name = "plate"
height = 0.07
center = [0.30, 0.40]
size = [0.30, 0.30]
thickness = 0.02
rpy = [0.1745, 0.0, 0.3]

[[supports]]
name = "upper"
height = 0.34
center = [0.30, 0.42]
size = [0.24, 0.24]
thickness = 0.02

[[supports]]
kind = "fixture"
name = "nest"
position = [-0.15, 0.45, 0.03]
rpy = [0.2618, 0.0, 0.0]
bodies = [
    { type = "box", name = "floor", position = [0.0, 0.0, -0.005], size = [0.09, 0.09, 0.01] },
    { type = "box", name = "back", position = [0.0, 0.045, 0.02], size = [0.09, 0.01, 0.06] },
]
poses = [{ name = "leaning", position = [0.0, 0.0, 0.0005], object = "bottle" }]
"""


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    path = tmp_path_factory.mktemp("cells") / "cell.toml"
    path.write_text(CELL, "utf-8")
    return RegraspProblem.load("bottle", path)


@pytest.fixture(scope="module")
def regrasped(problem):
    """A plan with an intermediate pose."""
    rng = np.random.default_rng(3)
    task = random_task(problem, rng, needs_regrasp=True)
    plan = solve_sequence(problem, task.start, task.goal)
    assert plan.solved and plan.num_regrasps
    return plan


def test_rests_are_placements_on_supports(problem):
    labels = [rest.label for rest in problem.rests]
    count = len(problem.placements)
    assert labels[:count] == [f"table/{m}" for m in range(count)]
    assert labels[-1] == "nest/leaning"
    for k, rest in enumerate(list(problem.rests)[:-1]):
        T = problem.pose(rest.placement, 0.02, -0.03, 0.7, support=rest.support.name)
        np.testing.assert_allclose(T, problem.rests.planar.at(k, [0.02, -0.03, 0.7]), atol=1e-12)
        bottom = rest.support.seen(problem.object.vertices @ T[:3, :3].T + T[:3, 3])[:, 2].min()
        assert abs(bottom) < 1e-9


def test_a_tilted_board_keeps_what_is_stable_at_every_yaw(problem):
    slope = np.tan(0.1745)
    there = {rest.placement for rest in problem.rests if rest.support.name == "plate"}
    assert there == {m for m, p in enumerate(problem.object.placements) if p.margin - slope >= 0.1}
    steep = replace(problem.workcell.supports[1], T_world_support=problem.workcell.supports[1].T_world_support.copy())
    steep.T_world_support[:3, :3] = rotation_rpy(0.45, 0.0, 0.0)
    cell = replace(problem.workcell, supports=(problem.workcell.table, steep))
    tilted = replace(problem, workcell=cell)
    assert len([rest for rest in tilted.rests if rest.support is steep]) < len(there)


def test_energies_agree_on_every_support(problem):
    """Lattice, NumPy landscape, CasADi and full poses give one energy on level and tilted boards and in the fixture."""
    planar, rng, energy = problem.rests.planar, np.random.default_rng(0), problem.energy
    lattice = problem.free_lattice
    picked = np.concatenate([rng.choice(np.flatnonzero(lattice.placements == s), 1) for s in range(len(planar))])
    T = planar.at(lattice.placements[picked], lattice.xi[picked])
    learned = energy(T)
    free = ~problem.rules.free_space(lattice.placements[picked], lattice.xi[picked])
    np.testing.assert_allclose(lattice.energies[picked][free], learned[free], rtol=1e-3, atol=1e-3)
    numbers = [1, next(k for k, rest in enumerate(problem.rests) if rest.support.name == "plate")]
    ends = rng.uniform(0, 3, (2, len(energy)))
    xi = planar.inside(np.array(numbers), rng.random((2, 3)))
    functions = energy.casadi_functions(placements=numbers, start=ends[0], goal=ends[1])
    np.testing.assert_allclose(functions.E(xi), energy(planar.at(numbers, xi)), atol=1e-8)
    objective = replace(problem.objective(*ends, CostOptions()), rule=None)
    cost, gradient = NumPyLandscape(objective, 2)(np.array([numbers]), xi[None], np.zeros((1, 2, len(energy)), bool))
    J = functions.J_seq
    assert cost[0] == pytest.approx(float(J(xi)), abs=1e-3)
    x = ca.MX.sym("xi", 2, 3)
    exact = np.array(ca.Function("g", [x], [ca.gradient(J(x), x)])(xi))
    np.testing.assert_allclose(gradient[0], exact, rtol=1e-2, atol=1e-2)


def test_plans_are_verified_by_the_certificate_and_moved(problem, regrasped, tmp_path):
    assert regrasped.residuals().hold
    names = {support.name for support in problem.workcell.supports}
    assert len(regrasped.stations) == 3 and {station.support for station in regrasped.stations} <= names
    assert plan_motion(regrasped).solved
    regrasped.save(tmp_path / "plan.json")
    again = RegraspPlan.load(tmp_path / "plan.json")
    assert [s[:2] for s in again.stations] == [s[:2] for s in regrasped.stations] and again.residuals().hold
    assert {t.arm for t in (*regrasped.transitions, *again.transitions)} == {"left"}


def test_the_arm_has_the_name_of_the_file(problem):
    T = problem.pose(0, -0.1, 0.3)
    np.testing.assert_array_equal(problem.feasible_grasps(T, arm="left"), problem.feasible_grasps(T))
    with pytest.raises(UnknownNameError, match="right"):
        problem.feasible_grasps(T, arm="right")


def test_a_leaning_nest_is_a_goal(problem):
    goal, rng = problem.pose(0, support="nest"), np.random.default_rng(0)
    plan = solve_sequence(problem, random_graspable_pose(problem, rng), goal)
    assert plan.solved and plan.stations[-1][:2] == ("nest", 0) and plan.residuals().hold


def test_the_certificate_sees_a_nest_in_the_object(problem):
    goal, rng = problem.pose(0, support="nest"), np.random.default_rng(0)
    plan = solve_sequence(problem, random_graspable_pose(problem, rng), goal)
    nest = problem.workcell.supports[3]
    deeper = [replace(s, pose=s.pose @ translation(0.0, 0.0, 0.004)) if "floor" in s.name else s for s in nest.shapes]
    supports = (*problem.workcell.supports[:3], replace(nest, shapes=tuple(deeper)))
    worse = replace(plan, problem=replace(problem, workcell=replace(problem.workcell, supports=supports)))
    assert any("the object is -0.0035 m from the nest" in text for text in worse.residuals().problems)


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        (translation(0.0, 0.0, -0.02), "sinks 20.0 mm into the upper"),
        (translation(0.0, 0.0, 0.02), "floats"),
        (translation(0.12, 0.0, 0.0), "outside the workspace of the support 'upper'"),
    ],
)
def test_ends_off_their_support_are_refused(problem, moved, said):
    T = moved @ problem.pose(0, 0.30, 0.42, support="upper")
    goal = problem.pose(0, -0.1, 0.3)
    with pytest.raises(PoseError, match=said):
        solve_sequence(problem, T, goal)


def test_an_object_between_boards_keeps_clear_of_the_upper_one(problem):
    under = problem.pose(4, 0.30, 0.42, support="plate")  # it stands
    cell = problem.workcell
    lower = replace(cell.supports[2], T_world_support=translation(0.0, 0.0, 0.28))
    low = replace(problem, workcell=replace(cell, supports=(*cell.supports[:2], lower, cell.supports[3])))
    assert problem.checker.object_problem(under) is None
    assert low.checker.object_problem(under) == "is too near to the support 'upper'"
    assert not low.feasible_grasps(under).any()


def test_the_certificate_sees_a_board_that_came_down(problem, regrasped):
    low = regrasped.stations[0]
    board = next(k for k, s in enumerate(problem.workcell.supports) if s.name == "upper")
    T = regrasped.poses[0]
    top = (problem.object.vertices @ T[:3, :3].T + T[:3, 3])[:, 2].max()
    x, y, _ = T[:3, :3] @ problem.object.center_of_mass + T[:3, 3]
    size, at = np.array([0.05, 0.05]), problem.workcell.supports[board]
    above = replace(at, T_world_support=translation(0.0, 0.0, top + 0.015), center=np.array([x, y]), size=size)
    supports = [above if k == board else s for k, s in enumerate(problem.workcell.supports)]
    worse = replace(regrasped, problem=replace(problem, workcell=replace(problem.workcell, supports=tuple(supports))))
    assert low.support != "upper"
    assert any("from the upper at pose 0" in text for text in worse.residuals().problems)


def test_weights_choose_among_supports(problem):
    rng = np.random.default_rng(3)
    task = random_task(problem, rng, needs_regrasp=True)
    used = solve_sequence(problem, task.start, task.goal).stations[1].support
    supports = tuple(replace(s, weight=50.0) if s.name == used else s for s in problem.workcell.supports)
    dear = replace(problem, workcell=replace(problem.workcell, supports=supports))
    plan = solve_sequence(dear, task.start, task.goal)
    assert plan.solved and plan.num_regrasps == 1 and plan.stations[1].support != used


@pytest.mark.parametrize(
    ("text", "support"), [("plate/0:0.30,0.40,45", "plate"), ("nest/leaning", "nest"), ("1:-0.1,0.3,0", "table")]
)
def test_poses_on_supports_are_typed_and_printed(problem, text, support):
    T = parse_pose(text, "goal", problem)
    station = problem.station(T)
    assert station.support == support
    np.testing.assert_allclose(parse_pose(describe_pose(T, problem), "goal", problem), T, atol=2e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("shelf/0:0,0,0", "unknown support 'shelf'"),
        ("nest/upright", "has nest/leaning"),
        ("plate/9:0,0,0", "placement 9"),
    ],
)
def test_poses_on_unknown_supports_are_refused(problem, text, said):
    with pytest.raises(PoseError, match=said):
        parse_pose(text, "goal", problem)


def test_a_nest_in_its_own_object_is_named(tmp_path):
    text = CELL.replace("position = [0.0, 0.0, 0.0005]", "position = [0.0, 0.02, 0.0005]")
    (tmp_path / "cell.toml").write_text(text, "utf-8")
    with pytest.raises(WorkcellError, match=r"cell.toml: 'bottle' overlaps 'nest back' by .* in pose 'leaning'"):
        RegraspProblem.load("bottle", tmp_path / "cell.toml")
    RegraspProblem.load("mug", tmp_path / "cell.toml")  # the pose is for another object


def test_a_bottle_is_not_lifted_through_the_wall_of_its_nest(tmp_path):
    """The object touches the floor of its nest at rest; how deep it is in the walls is measured all the same."""
    text = CELL.replace("position = [0.0, 0.0, 0.0005], object", "position = [0.0, 0.0, -0.0004], object")
    (tmp_path / "cell.toml").write_text(text, "utf-8")
    problem = RegraspProblem.load("bottle", tmp_path / "cell.toml")
    T, solid = problem.pose(0, support="nest"), problem.object.solid
    floor, back = problem.workcell.supports[3].shapes
    near = [separation(solid, Solid(shape_geometry(s)), T, s.pose) for s in (floor, back)]
    assert near[0] == pytest.approx(-0.0004, abs=1e-6) and near[1] > 0.005
    scene = MotionScene(problem)
    height = scene._height_in(T, 3)
    assert height == pytest.approx(-0.0004, abs=1e-6)
    pushed = T @ translation(0.0, near[1] + 0.002, 0.005)
    assert scene._height_in(pushed, 3) < height - 1e-3


def test_measured_poses_are_put_on_the_support_that_they_were_measured_on(problem):
    """On boards, level and tilted, and in the fixture; a label is what the command line takes."""
    rng, seen = np.random.default_rng(0), set()
    numbers, xi = problem.rests.planar.draw(60, rng)
    numbers, xi = np.append(numbers, len(problem.rests) - 1), np.vstack([xi, np.zeros(3)])
    for number, T in zip(numbers, problem.rests.planar.at(numbers, xi), strict=True):
        rest = problem.rests[number]
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.02, 3)).as_matrix()
        middle = T[:3, :3] @ problem.object.center_of_mass + T[:3, 3]
        M = T.copy()
        M[:3, :3], M[:3, 3] = turn @ T[:3, :3], turn @ (T[:3, 3] - middle) + middle + rng.normal(0.0, 0.003, 3)
        found = problem.at_rest(M, (0.015, 0.12))
        assert (found.support, found.placement) == (rest.support.name, rest.placement)
        assert problem.station(found.T).support == rest.support.name
        error = pose_distance(parse_pose(found.label, "start", problem), found.T)
        assert error[0] < 2e-3 and error[1] < 2e-3
        seen.add(found.support)
    assert seen == {"table", "plate", "upper", "nest"}
    np.testing.assert_allclose(found.T, T, atol=1e-12)  # the fixture leaves no freedom


def test_a_plan_from_a_pose_measured_in_the_fixture(problem):
    nest = problem.rests.planar.at(len(problem.rests) - 1, np.zeros(3))
    M = translation(0.001, -0.001, 0.002) @ nest
    plan = solve_sequence(problem, M, problem.pose(0, -0.2, 0.3), "exact")
    assert plan.solved and plan.stations[0].support == "nest" and plan.residuals().hold
    assert plan.remarks == ("the start was measured 2.4 mm and 0.0 degrees from rest and is planned at nest/leaning",)
