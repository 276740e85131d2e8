"""Distances in CasADi, held to Coal, and their gradients to finite differences."""

import casadi as ca
import coal
import numpy as np
import pytest
from derivatives import assert_derivative
from scipy.spatial.transform import Rotation

from regrasp_opt.robots.casadi_distances import (
    ROUNDING,
    capsule_distance,
    point_box_distance,
    segment_squared_distance,
)


@pytest.fixture(scope="module")
def capsules():
    """Return the distance of two capsules as a function of four points and two radii."""
    a, b, c, d = (ca.SX.sym(name, 3) for name in "abcd")
    r, s = ca.SX.sym("r"), ca.SX.sym("s")
    return ca.Function("capsules", [a, b, c, d, r, s], [capsule_distance(a, b, r, c, d, s)])


def placed(a, b, radius):
    """Return Coal's capsule (or sphere) from `a` to `b`, and its pose."""
    length = float(np.linalg.norm(b - a))
    if length == 0:
        return coal.Sphere(radius), coal.Transform3s(np.eye(3), a)
    R = Rotation.align_vectors([(b - a) / length], [[0, 0, 1]])[0].as_matrix()
    return coal.Capsule(radius, length), coal.Transform3s(R, (a + b) / 2)


def coal_distance(first, second):
    return coal.distance(*first, *second, coal.DistanceRequest(), coal.DistanceResult())


def segments(kind, rng):
    a, b, c, d = rng.uniform(-0.5, 0.5, (4, 3))
    if kind == "parallel":
        d = c + rng.uniform(-2, 2) * (b - a)
    if kind == "sphere":
        d = c
    if kind == "two spheres":
        b, d = a, c
    if kind == "nearly parallel":
        d = c + (b - a) + 1e-5 * rng.normal(size=3)
    if kind == "in line":
        c, d = b + 0.3 * (b - a), b + 0.9 * (b - a)
    return a, b, c, d


@pytest.mark.parametrize("kind", ["skew", "parallel", "nearly parallel", "in line", "sphere", "two spheres"])
def test_capsules_are_as_far_apart_as_coal_says(kind, capsules):
    rng = np.random.default_rng(0)
    compared = 0
    for _ in range(300):
        a, b, c, d = segments(kind, rng)
        radii = rng.uniform(0.01, 0.08, 2)
        expected = coal_distance(placed(a, b, radii[0]), placed(c, d, radii[1]))
        if expected < 1e-3:
            continue
        compared += 1
        found = float(capsules(a, b, c, d, *radii))
        assert found == pytest.approx(expected, abs=1e-6 if "parallel" in kind else 1e-7)
    assert compared > 100


def test_a_sphere_is_a_capsule_without_length(capsules):
    rng = np.random.default_rng(1)
    for _ in range(50):
        p, a, b = rng.uniform(-0.5, 0.5, (3, 3))
        found = float(capsules(p, p, a, b, 0.03, 0.05))
        assert found == pytest.approx(coal_distance(placed(p, p, 0.03), placed(a, b, 0.05)), abs=1e-6)


def test_gradients_hold_across_the_ends_of_segments():
    flat = ca.SX.sym("x", 12)
    value = ca.sqrt(segment_squared_distance(*ca.vertsplit(flat, 3)) + ROUNDING**2)
    function = ca.Function("d", [flat], [value, ca.jacobian(value, flat)])
    rng = np.random.default_rng(2)
    for _ in range(40):
        x = rng.uniform(-0.5, 0.5, 12)
        assert_derivative(lambda y: float(function(y)[0]), np.array(function(x)[1])[0], x, tolerance=1e-5)


def test_gradients_are_finite_at_contact():
    flat = ca.SX.sym("x", 12)
    value = ca.sqrt(segment_squared_distance(*ca.vertsplit(flat, 3)) + ROUNDING**2)
    gradient = ca.Function("g", [flat], [ca.jacobian(value, flat)])
    crossing = np.array([-1, 0, 0, 1, 0, 0, 0, -1, 0, 0, 1, 0], dtype=float)
    assert np.isfinite(np.array(gradient(crossing))).all()
    assert np.isfinite(np.array(gradient(np.zeros(12)))).all()


def test_a_point_is_as_far_from_a_box_as_coal_says():
    rng = np.random.default_rng(3)
    half = np.array([0.1, 0.25, 0.4])
    for p in rng.uniform(-0.6, 0.6, (200, 3)):
        found = float(ca.DM(point_box_distance(ca.DM(p), ca.DM(half))))
        if (np.abs(p) < half).all():
            assert found == pytest.approx(-(half - np.abs(p)).min(), abs=2e-6)
        else:
            box = coal.Box(*(2 * half)), coal.Transform3s.Identity()
            assert found == pytest.approx(
                coal_distance((coal.Sphere(1e-9), coal.Transform3s(np.eye(3), p)), box), abs=2e-6
            )
