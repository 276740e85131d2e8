"""A light touch is a collision, and what was asked before changes no answer."""

import numpy as np
import pinocchio as pin
import pytest
from collisions import colliding_links

from regrasp_opt.robots import load_robot
from regrasp_opt.scene.collision_model import settle_queries


@pytest.fixture(scope="module")
def nova2():
    return load_robot("nova2")


def light_touches(nova2, count):
    """Return (configurations, depths): links overlap by 1 to 500 micrometres there."""
    model, geometry = nova2.model, nova2.collision.copy()
    for i, j in nova2.self_collision_pairs():
        geometry.addCollisionPair(pin.CollisionPair(i, j))
    data, gaps = model.createData(), geometry.createData()
    settle_queries(gaps, np.zeros(len(geometry.collisionPairs)))

    def gap(q):
        pin.computeDistances(model, data, geometry, gaps, q)
        return min(result.min_distance for result in gaps.distanceResults)

    rng, found = np.random.default_rng(3), []
    while len(found) < count:
        free, hit = rng.uniform(nova2.lower, nova2.upper, (2, nova2.dof))
        if not gap(hit) < 0 < gap(free):
            continue
        for _ in range(60):
            middle = (free + hit) / 2
            depth = -gap(middle)
            if 1e-6 < depth < 10 ** rng.uniform(-6, -3.3):
                found.append((middle, depth))
                break
            free, hit = (free, middle) if depth > 0 else (middle, hit)
    return zip(*found, strict=True)


def test_a_light_touch_is_a_collision(nova2):
    q, depths = light_touches(nova2, 300)
    assert 1e-6 < min(depths) < 5e-6 and 1e-4 < max(depths) < 1e-3
    assert [colliding_links(nova2, one) is not None for one in q] == [True] * 300


def test_an_overlap_that_was_once_taken_for_free(nova2):
    q = [-2.398900667488169, 0.36494666528275693, 1.9884751909140332, 2.0576083963426073, 1.3266432379595723]
    assert colliding_links(nova2, [*q, 0.9097905283065267]) == ("link2", "link5")
