"""The verification of trajectories: nothing thin is missed, and the bound on motion between samples holds."""

import numpy as np
import pytest

from regrasp_opt.motion.trajectory.collision_context import LEVELS, CollisionContext, MotionScene
from regrasp_opt.motion.trajectory.continuous_collision import _spread, verify
from regrasp_opt.motion.trajectory.time_parameterization import rest_to_rest
from regrasp_opt.motion.trajectory.trajectory import MotionLimits, Trajectory


def point_setting(obstacles, radius=0.0):
    """Return a setting for a point on a rail of one prismatic joint, with obstacles at places of it."""

    def passes(q, level):
        return all(abs(float(q[0]) - x) - radius > LEVELS[level] / 2 for x in obstacles)

    return CollisionContext(passes, np.ones(1))


def rail(a, b):
    return rest_to_rest(np.array([a]), np.array([b]), MotionLimits(np.ones(1), np.ones(1), np.full(1, np.inf)))


def count_tests(setting, way):
    """Return how many tests it takes to verify a way that is free."""
    asked = []

    def passes(q, level):
        asked.append(q)
        return setting.passes(q, level)

    assert verify(CollisionContext(passes, np.ones(1)), way)
    return len(asked)


def test_a_free_way_is_verified_with_few_tests():
    assert count_tests(point_setting([2.0]), rail(0.0, 1.0)) <= 2.0 / LEVELS[0]


@pytest.mark.parametrize("place", np.linspace(0.11, 0.97, 7))
def test_an_obstacle_of_no_width_is_found(place):
    assert not verify(point_setting([place]), rail(0.0, 1.0))


def test_a_near_miss_is_verified_by_bisection():
    near, far = (count_tests(point_setting([place]), rail(0.0, 1.0)) for place in (1.0 + 1e-4, 2.0))
    assert near > far
    assert not verify(point_setting([1.0 + 2e-5]), rail(0.0, 1.0))


def test_an_excursion_between_knots_is_found():
    # both knots are at rest at 0.5 from the obstacle, but the cubic between them swings past it
    loop = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 1)), np.array([[4.0], [4.0]]))
    swing = np.abs(loop.at(np.linspace(0, 1, 1001))).max()
    assert swing > 0.3
    assert not verify(point_setting([0.3]), loop)
    assert verify(point_setting([swing + 0.01, -swing - 0.01]), loop)


@pytest.mark.parametrize("place", np.linspace(0.05, 0.95, 10))
def test_an_excursion_among_many_short_pieces_is_found(place):
    """Pieces are tested many at once; only one of them swings out and back, between its knots."""
    times, at_rest = np.linspace(0.0, 1.0, 101), np.zeros((101, 1))
    one = int(place * 100)
    swinging = at_rest.copy()
    swinging[one : one + 2] = 4.0
    path = Trajectory(times, at_rest, swinging)
    swing = np.abs(path.at(np.linspace(0, 1, 20_001))).max()
    assert not verify(point_setting([0.9 * swing, -0.9 * swing]), path)
    assert verify(point_setting([swing + 0.01, -swing - 0.01]), path)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9, 100])
def test_the_order_of_intervals_leaves_none_out(count):
    assert sorted(_spread(count)) == list(range(count))


def test_no_corner_of_a_body_moves_farther_than_the_bound(bottle_problem):
    scene, robot = MotionScene(bottle_problem), bottle_problem.workcell.robot
    effector = bottle_problem.workcell.end_effector
    setting = scene.holding(0)
    T_flange_object = effector.T_flange_tcp @ np.linalg.inv(bottle_problem.grasps.T_object_tcp[0])
    points = np.column_stack([bottle_problem.object.vertices, np.ones(len(bottle_problem.object.vertices))])
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = robot.home + 0.5 * rng.normal(size=(2, 6))
        q = a + np.linspace(0, 1, 200)[:, None] * (b - a)
        T = robot.forward(q)
        held = (T @ T_flange_object @ points.T)[:, :3]
        way = np.linalg.norm(np.diff(held, axis=0), axis=1).sum(axis=0).max()
        assert way <= setting.travel(b - a) + 1e-9
        links = robot.link_transforms(q)[:, :, :3, 3]
        assert np.linalg.norm(np.diff(links, axis=0), axis=2).sum(axis=0).max() <= setting.travel(b - a) + 1e-9
