"""The sampling planner on a wall with a gap."""

import itertools

import numpy as np
import pytest

from regrasp_opt.motion.trajectory.collision_context import CollisionContext
from regrasp_opt.motion.trajectory.sampling import SPACING, polyline

LIMITS = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
START, GOAL = np.array([-0.5, 0.0]), np.array([0.5, 0.0])


def wall(gap, thickness=0.2):
    """Return a setting of a point in the plane and a wall along y with a `gap` [m] at its upper end."""

    def passes(q, level):
        return bool(abs(q[0]) > thickness / 2 or q[1] > 1.0 - gap)

    return CollisionContext(passes, np.ones(2))


@pytest.mark.parametrize("seed", range(5))
def test_a_way_around_is_found_and_free(seed):
    corners = polyline(wall(0.3), START, GOAL, LIMITS, np.random.default_rng(seed), iterations=500)
    assert np.array_equal(corners[[0, -1]], [START, GOAL])
    for a, b in itertools.pairwise(corners):
        # edges are sampled, so half a spacing of the wall's edge may be cut off; the verification does not allow that
        inner = wall(0.3 + SPACING / 2, 0.2 - SPACING)
        assert all(inner.passes(a + u * (b - a), 0) for u in np.linspace(0, 1, 400))
    assert ((corners >= LIMITS[0]) & (corners <= LIMITS[1])).all()
    length = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
    assert length < 1.6 * 2 * np.hypot(0.4, 0.7)


def test_the_same_seed_gives_the_same_way():
    first, second, other = (
        polyline(wall(0.3), START, GOAL, LIMITS, np.random.default_rng(seed), iterations=500) for seed in (1, 1, 2)
    )
    assert np.array_equal(first, second) and not np.array_equal(first, other)


def test_no_way_is_none():
    assert polyline(wall(0.0), START, GOAL, LIMITS, np.random.default_rng(0), iterations=100) is None


def test_a_free_straight_way_has_no_corners():
    free = CollisionContext(lambda q, level: True, np.ones(2))
    corners = polyline(free, START, GOAL, LIMITS, np.random.default_rng(0), iterations=1)
    assert np.array_equal(corners, [START, GOAL])
