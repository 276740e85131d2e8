"""Settings of the motion scene against distances measured one pair at a time."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from regrasp_opt.motion.trajectory.collision_context import FLOOR, LEVELS, TOUCH, MotionScene


@pytest.fixture(scope="module")
def scene(bottle_problem):
    return MotionScene(bottle_problem)


def least_excess(bodies, data, model, q, level, skipped=0):
    """Return the least (distance - what the level requires) over all pairs, each measured by itself."""
    geometry = bodies.geometry
    pin.forwardKinematics(model, data, q)
    fresh = geometry.createData()
    pin.updateGeometryPlacements(model, data, geometry, fresh)
    excess = []
    for k in range(len(geometry.collisionPairs) - skipped):
        pair = geometry.collisionPairs[k]
        shapes = [geometry.geometryObjects[i].geometry for i in (pair.first, pair.second)]
        poses = [coal.Transform3s(fresh.oMg[i].rotation, fresh.oMg[i].translation) for i in (pair.first, pair.second)]
        distance = coal.distance(
            shapes[0], poses[0], shapes[1], poses[1], coal.DistanceRequest(), coal.DistanceResult()
        )
        required = bodies.required[k]
        excess.append(distance - max(required, FLOOR * required + LEVELS[level] / 2))
    return min(excess)


@pytest.mark.parametrize("kind", ["beside", "closing", "holding", "lifting"])
def test_a_setting_passes_where_every_distance_suffices(scene, bottle_plan, kind):
    rng = np.random.default_rng(0)
    transition, T = bottle_plan.transitions[0], bottle_plan.poses[0]
    grasp_id, q_pick = int(transition.grasp_ids[0]), transition.q_pick[0]
    width = float(bottle_plan.problem.grasps.width[grasp_id])
    bodies, skipped, make = {
        "beside": (scene._free, 0, lambda: scene.beside(T, (width + 0.004, width + 0.02))),
        "closing": (scene._free, 3, lambda: scene.closing(T, (width, width + 0.01))),
        "holding": (scene._held, 0, lambda: scene.holding(grasp_id)),
        "lifting": (scene._held, 1, lambda: scene.lifting(grasp_id, T)),
    }[kind]
    setting = make()
    outcomes = []
    for _ in range(60):
        q, level = q_pick + rng.normal(size=6) * rng.choice([0.03, 0.2, 1.0]), int(rng.integers(len(LEVELS)))
        passed = setting.passes(q, level)
        excess = least_excess(bodies, bodies.data, bodies.model, q, level, skipped)
        if abs(excess) < 1e-6:
            continue
        if kind == "lifting" and not passed and excess > 0:
            continue  # the table, which is tested below
        assert passed == (excess > 0)
        outcomes.append(passed)
    assert 3 <= sum(outcomes) <= len(outcomes) - 3


def test_a_setting_is_arranged_again_when_another_was_used_in_between(scene, bottle_plan):
    transition = bottle_plan.transitions[0]
    q, last = transition.q_pick[0], len(LEVELS) - 1
    width = float(bottle_plan.problem.grasps.width[transition.grasp_ids[0]])
    here = scene.beside(bottle_plan.poses[0], (width + 0.01, width + 0.01))
    tight = scene.beside(bottle_plan.poses[0], (width - 0.01, width - 0.01))
    for _ in range(2):
        assert here.passes(q, last)
        assert not tight.passes(q, last)  # the fingers stand in the object


def test_lifting_allows_contact_with_the_table_and_no_more(scene, bottle_plan):
    robot, last = bottle_plan.problem.workcell.robot, len(LEVELS) - 1
    transition, T = bottle_plan.transitions[0], bottle_plan.poses[0]
    grasp_id = int(transition.grasp_ids[0])
    lifting, holding = scene.lifting(grasp_id, T), scene.holding(grasp_id)

    def moved(z):
        target = robot.forward(transition.q_pick[0])
        target[2, 3] += z
        found = robot.solve_ik(target).q
        return found[np.abs(found - transition.q_pick[0]).max(axis=1).argmin()]

    assert lifting.passes(moved(0.0), last)
    assert not lifting.passes(moved(-2 * TOUCH), last)
    assert not holding.passes(moved(0.0), last) and not holding.passes(moved(0.0025), last)
    assert holding.passes(moved(0.004), last)
    # far above, the larger levels pass as well; near the table they do not
    assert lifting.passes(moved(0.05), 0) and not lifting.passes(moved(0.01), 0)


def test_the_arm_keeps_its_clearance_from_the_resting_object(scene, bottle_plan):
    """A link put 4 mm from the object passes no level: the arm's clearance is 5 mm."""
    cell, data = bottle_plan.problem.workcell, scene._free.data
    q = cell.robot.home
    pin.forwardKinematics(cell.robot.model, data, q)
    wrist = data.oMi[6].translation  # link 6 is a cylinder of radius 35.5 mm about its joint's axis
    axis = data.oMi[6].rotation[:, 0]
    corners = bottle_plan.problem.object.vertices
    for gap, expected in ((0.004, False), (0.007, True)):
        T = np.eye(4)
        T[:3, 3] = wrist + axis * (0.0355 + gap)
        T[:3, 3] -= axis * (corners @ axis).min() + (np.eye(3) - np.outer(axis, axis)) @ corners.mean(axis=0)
        T[2, 3] += 0.018  # between the cylinder's ends
        setting = scene.beside(T, (0.05, 0.05))
        touching = [
            k
            for k, pair in enumerate(scene._free.geometry.collisionPairs)
            if scene._free.geometry.geometryObjects[pair.second].name == "object"
        ]
        assert touching
        assert setting.passes(q, len(LEVELS) - 1) == expected
