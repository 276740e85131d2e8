"""What is drawn is what the plan says: poses of hand and object, energies, costs, motions."""

from dataclasses import dataclass, replace
from enum import Enum

import coal
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp_opt.connectivity import CostOptions, SequenceObjective
from regrasp_opt.connectivity.objective import exact_energy
from regrasp_opt.conventions import translation
from regrasp_opt.viz import fields, looks, scene, surfaces, track
from regrasp_opt.viz.page import _content


def matrices(pose7):
    T = np.tile(np.eye(4), (*pose7.shape[:-1], 1, 1))
    T[..., :3, :3] = Rotation.from_quat(pose7[..., 3:].reshape(-1, 4)).as_matrix().reshape(*pose7.shape[:-1], 3, 3)
    T[..., :3, 3] = pose7[..., :3]
    return T


@pytest.fixture(scope="module")
def drawn(plan):
    return scene.plan_scene(plan)


def test_in_every_state_the_hand_holds_the_object_by_its_grasp(plan, drawn):
    dof = plan.problem.workcell.robot.dof
    for i, (transition, shared) in enumerate(zip(plan.transitions, drawn.grasps, strict=True)):
        for k, grasp_id in enumerate(transition.grasp_ids):
            rows = drawn.states[shared.first_state + 2 * k :][:2].astype(float)
            T_object, T_flange = matrices(rows[:, -1]), matrices(rows[:, dof])
            np.testing.assert_allclose(T_object, plan.poses[i : i + 2], atol=1e-6)
            tcp = T_flange @ plan.problem.workcell.end_effector.T_flange_tcp
            np.testing.assert_allclose(tcp, T_object @ plan.problem.grasps.T_object_tcp[grasp_id], atol=5e-6)
            apart = np.linalg.norm(rows[:, dof + 1, :3] - rows[:, dof + 2, :3], axis=1)
            np.testing.assert_allclose(apart, plan.problem.grasps.width[grasp_id], atol=1e-6)


def test_steps_show_the_clearest_grasp_of_each_move(plan, drawn):
    assert [step.label for step in drawn.steps] == [
        f"move {i}: {what}" for i in range(len(plan.transitions)) for what in ("pick", "place")
    ]
    for step in drawn.steps:
        shared = drawn.grasps[step.transition]
        assert (step.state - shared.first_state) // 2 == shared.best == shared.clearance.argmax()


def test_grasps_are_coloured_by_their_energy(plan, drawn):
    energies = plan.problem.energy(plan.poses)
    for i, shared in enumerate(drawn.grasps):
        np.testing.assert_allclose(shared.energies, (energies[i] + energies[i + 1])[shared.ids], rtol=1e-9)
        lightness = shared.colours.astype(float) @ (0.2126, 0.7152, 0.0722)
        order = np.argsort(shared.energies)
        assert (np.diff(lightness[order]) >= -2).all()
        assert lightness[order[0]] < lightness[order[-1]]


def test_the_field_is_the_cost_of_moving_the_pose(plan):
    problem = plan.problem
    field = fields.cost_field(plan, 1)
    ends = [exact_energy(problem.feasible_grasps(T)) for T in (plan.poses[0], plan.poses[-1])]
    bounds = problem.workcell.bounds.array
    objective = SequenceObjective(problem.energy, problem.rests.planar, *ends, CostOptions(), problem.table_rule)
    rng = np.random.default_rng(0)
    for row, column in zip(rng.integers(len(field.y), size=6), rng.integers(len(field.x), size=6), strict=True):
        xi = np.array([[[field.x[column], field.y[row], plan.xi[0, 2]]]])
        cost = objective.cost(plan.placements[None], xi)[0]
        assert field.cost[row, column] == pytest.approx(min(cost, fields.BLOCKED), abs=1e-3)
    assert [field.x[0], field.y[0], field.x[-1], field.y[-1]] == pytest.approx([*bounds[0], *bounds[1]])


def test_a_problem_is_drawn_at_home_and_in_its_placements(bottle_problem, drawn):
    body, cell = bottle_problem.object, bottle_problem.workcell
    found = scene.problem_scene(body, cell)
    assert [part.name for part in found.parts] == [part.name for part in drawn.parts]
    assert len(found.ghosts) == len(found.states) == len(found.steps) == len(body.placements)
    flange = cell.T_world_base @ cell.robot.forward(cell.robot.home)
    for state, (_, _, ghost), placement in zip(found.states, found.ghosts, body.placements, strict=True):
        np.testing.assert_allclose(matrices(state[cell.robot.dof]), flange, atol=1e-9)
        np.testing.assert_allclose(state[-1], ghost)
        T = matrices(ghost)
        np.testing.assert_allclose(T[:3, :3], placement.pose[:3, :3], atol=1e-9)
        low, high = cell.bounds.array
        assert ((T[:3, :3] @ body.center_of_mass + T[:3, 3])[:2] >= low).all() and (T[:2, 3] <= high + 0.1).all()
    nowhere = scene.problem_scene(replace(body, placements=()), cell)
    assert nowhere.ghosts == () and [step.label for step in nowhere.steps] == ["home"]
    assert set(_content(nowhere)) == set(_content(drawn))


class Phase(Enum):
    APPROACH = False
    TRANSFER = True
    RETREAT = None

    @property
    def holds(self):
        return bool(self.value)


@dataclass
class Straight:
    a: np.ndarray
    b: np.ndarray
    duration: float = 0.5

    def at(self, t):
        return self.a + np.asarray(t)[:, None] / self.duration * (self.b - self.a)


@dataclass
class Segment:
    phase: Phase
    transition: int
    grasp_id: int
    trajectory: Straight
    jaw: tuple


def test_in_a_motion_the_object_moves_only_with_the_hand(plan):
    t = plan.transitions[0]
    pick, place, grasp = t.q_pick[1], t.q_place[1], int(t.grasp_ids[1])
    motion = [
        Segment(Phase.APPROACH, 0, grasp, Straight(pick + 0.1, pick), (0.08, 0.05)),
        Segment(Phase.TRANSFER, 0, grasp, Straight(pick, place), (0.05, 0.05)),
        Segment(Phase.RETREAT, 0, grasp, Straight(place, place + 0.1), (0.05, 0.08)),
    ]
    assert grasp != t.grasp_ids[t.clearance.argmax()]
    found = track.track_of(plan, motion, rate=10.0)
    assert found.times == pytest.approx(np.arange(16) / 10)
    assert found.labels[0] == "move 0: approach" and found.labels[-1] == "move 0: retreat"
    assert found.jaw[[0, 1, 7, 15]] == pytest.approx([0.08, 0.074, 0.05, 0.08])
    np.testing.assert_allclose(found.q[7], pick + 0.4 * (place - pick))
    np.testing.assert_allclose(found.T_world_object[:6], np.tile(plan.poses[0], (6, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(found.T_world_object[10:], np.tile(plan.poses[1], (6, 1, 1)), atol=1e-6)
    assert np.abs(np.diff(found.T_world_object[5:11], axis=0)).max(axis=(1, 2)).min() > 1e-3
    shown = scene.plan_scene(plan, found)
    assert shown.grasps[0].ids[shown.grasps[0].best] == grasp
    assert shown.seconds == pytest.approx(1.5) and len(shown.steps) == 16
    last = matrices(shown.states[shown.steps[-1].state].astype(float))
    np.testing.assert_allclose(last[-1], plan.poses[1], atol=1e-6)


@pytest.mark.parametrize("radius, length", [(0.05, 0.3), (0.05, 0.01), (0.001, 0.2)])
def test_rounded_cylinders_stay_within_the_cylinder(radius, length):
    vertices, faces = surfaces.rounded_cylinder(radius, length)
    assert np.linalg.norm(vertices[:, :2], axis=1).max() == pytest.approx(radius)
    assert np.abs(vertices[:, 2]).max() == pytest.approx(length / 2)
    assert outward(vertices, faces)


def test_boxes_keep_their_size():
    size = np.array([0.1, 0.02, 0.004])
    vertices, faces = surfaces.chamfered_box(size)
    assert np.ptp(vertices, axis=0) == pytest.approx(size)
    assert outward(vertices, faces)


def outward(vertices, faces):
    """Return whether the triangles enclose a positive volume."""
    return np.einsum("fi,fi->", vertices[faces[:, 0]], np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]])) > 0


@pytest.mark.parametrize(
    "geometry", [coal.Box(0.1, 0.2, 0.3), coal.Sphere(0.1), coal.Cylinder(0.1, 0.3), coal.Capsule(0.1, 0.3)]
)
def test_robots_look_no_larger_than_they_collide(geometry):
    geometry.computeLocalAABB()
    vertices, faces = surfaces.coal_surface(geometry)
    box = geometry.aabb_local
    assert np.ptp(vertices, axis=0) == pytest.approx(np.ravel(box.max_ - box.min_), abs=2e-3)
    assert outward(vertices, faces)


def test_parts_of_joints_move_with_them(plan):
    robot = plan.problem.workcell.robot
    parts = looks.robot_parts(robot, translation(1.0, 0.0, 0.0))
    assert {part.body for part in parts} == set(range(-1, robot.dof))
    base = [part.surface.vertices for part in parts if part.body == looks.BASE]
    assert np.concatenate(base)[:, 0].mean() == pytest.approx(1.0, abs=0.02)


def test_a_suction_cup_is_drawn():
    from regrasp_opt.scene import load_workcell

    effector = load_workcell("nova2-s1").end_effector
    assert [part.body for part in looks.gripper_parts(effector, 6)] == [6]
    assert outward(*looks.grasp_mark(effector))
