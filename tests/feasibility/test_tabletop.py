"""What the table rules out: never a feasible grasp, and no fewer than the gripper's corners in it."""

from dataclasses import replace

import coal
import numpy as np
import pytest
import trimesh
from transforms import random_transforms

from regrasp_opt.connectivity import TableRule
from regrasp_opt.conventions import invert, planar_transform, translation
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.tabletop import _extreme, points_in_support, wrist_bodies
from regrasp_opt.geometry.shapes import Mesh, mesh_geometry, shape_geometry, surface_points
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.objects import load_object
from regrasp_opt.robots import load_robot
from regrasp_opt.scene import Support, load_workcell


def points_in_table(cell, grasps, placements):
    """Return the points at `placements` (S, 4, 4) T_world_object on the table of `cell`."""
    seen = invert(cell.table.T_world_support) @ placements
    return points_in_support(cell, grasps, seen, [cell.table] * len(placements))


def rule(cell, grasps, placements):
    return TableRule(points_in_table(cell, grasps, placements), cell.table.edges)


@pytest.mark.parametrize(
    ("name", "cell_name"), [("bottle", "nova2-w"), ("mug", "nova2-s2"), ("figurine", "nova2-r140")]
)
@pytest.mark.parametrize("size", [(1.4, 1.2), (1.0, 0.7)])
def test_no_feasible_grasp_is_ruled_out(name, cell_name, size):
    cell = load_workcell(cell_name)
    table = cell.table
    cell = replace(cell, supports=(Support.table(table.height, table.center, np.array(size), table.thickness),))
    model = load_object(name)
    grasps = sample_grasps(model, cell.end_effector, 60, seed=2)
    placements = np.array([p.pose for p in model.placements])
    checker, ruled_out = FeasibilityChecker(model, cell, grasps), rule(cell, grasps, placements)
    rng = np.random.default_rng(0)
    numbers = rng.integers(len(placements), size=60)
    xi = np.column_stack([rng.uniform(*cell.bounds.array, (60, 2)), rng.uniform(-np.pi, np.pi, 60)])
    feasible = np.array([checker.feasible(T) for T in planar_transform(xi) @ placements[numbers]])
    verdict = ruled_out(numbers, xi)
    assert feasible.any() and verdict.any()
    assert not (feasible & verdict).any()


def test_the_rule_holds_where_the_point_is_within_the_edges():
    point = np.array([[[0.2, 0.0], [np.nan, np.nan]]])
    ruled_out = TableRule(point, np.array([[-0.5, 0.0], [0.5, 1.0]]))
    xi = np.array([[0.0, 0.5, 0.3], [0.4, 0.5, 0.0], [0.4, 0.5, np.pi], [0.0, 0.85, np.pi / 2], [0.0, 2.0, 0.0]])
    verdict = ruled_out(np.zeros(5, dtype=int), xi)
    assert verdict.tolist() == [[True, False], [False, False], [True, False], [False, False], [False, False]]


def test_bodies_round_about_the_last_joint_belong_to_the_wrist():
    robot = load_workcell("nova2-w").robot
    before = robot.chain.forward(np.zeros(robot.dof))
    bodies = wrist_bodies(robot)
    assert len(bodies) > sum(item.parentJoint == robot.dof for item in robot.collision.geometryObjects)
    names = {id(geometry) for geometry, _ in bodies}
    assert len(names) == len(bodies)
    for q6 in (0.7, -2.0):
        q = np.zeros(robot.dof)
        q[-1] = q6
        links = robot.link_transforms(q)
        flange = robot.forward(q)
        for item in robot.collision.geometryObjects:
            world = (np.eye(4) if item.parentJoint == 0 else links[item.parentJoint - 1]) @ item.placement.homogeneous
            for geometry, T in bodies:
                if geometry is item.geometry:
                    np.testing.assert_allclose((flange @ T)[:3, 3], world[:3, 3], atol=1e-9)
                    along = 1.0 if isinstance(geometry, coal.Sphere) else abs((flange @ T)[:3, 2] @ world[:3, 2])
                    np.testing.assert_allclose(along, 1.0, atol=1e-9)
    assert not np.allclose(before, robot.forward(q))


QUARTER = np.pi / 2
BEFORE_THE_LAST_JOINT = [
    ("<sphere radius='0.01'/>", "0.3 0 0", "0 0 0"),
    ("<sphere radius='0.02'/>", "0.3 0 0.2", "0 0 0"),
    ("<cylinder radius='0.03' length='0.3'/>", "0.1 0 0.2", f"0 {QUARTER} 0"),
    ("<cylinder radius='0.04' length='0.3'/>", "0.1 0 0.2", "0 0 0"),
    ("<cylinder radius='0.05' length='0.3'/>", "0.1 0 0.2", f"{QUARTER} 0 0"),
    ("<cylinder radius='0.06' length='0.3'/>", "0.1 0.05 0.2", f"0 {QUARTER} 0"),
    ("<box size='0.14 0.14 0.14'/>", "0.1 0 0.2", "0 0 0"),
]
"""Bodies, of which the second and the third are round about an axis along x at z = 0.2."""


def arm_urdf(last):
    """Return a URDF with joints about y and z, and one of the kind `last` along x, 0.2 above the joint before."""
    shapes = [
        f"<collision><origin xyz='{xyz}' rpy='{rpy}'/><geometry>{shape}</geometry></collision>"
        for shape, xyz, rpy in BEFORE_THE_LAST_JOINT
    ]
    tool = "<collision><geometry><box size='0.16 0.16 0.16'/></geometry></collision>"
    contents = ["", "", "".join(shapes), tool]
    links = [f"<link name='link{i}'>{content}</link>" for i, content in enumerate(contents)]
    joints = [
        f"<joint name='joint{i}' type='{kind}'><parent link='link{i}'/><child link='link{i + 1}'/>"
        f"<origin xyz='0 0 0.2'/><axis xyz='{axis}'/><limit lower='-3' upper='3' velocity='1' effort='1'/></joint>"
        for i, (kind, axis) in enumerate([("revolute", "0 1 0"), ("revolute", "0 0 1"), (last, "1 0 0")])
    ]
    return "".join(["<robot name='arm'>", *links, *joints, "</robot>"])


@pytest.mark.parametrize(
    ("last", "radii"), [("revolute", [0.02, 0.03, 0.08]), ("prismatic", [0.08])], ids=["turning", "sliding"]
)
def test_no_body_belongs_to_the_wrist_that_the_last_joint_would_move(last, radii, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(last))
    found = [
        getattr(geometry, "radius", None) or geometry.halfSide[0] for geometry, _ in wrist_bodies(load_robot(path))
    ]
    np.testing.assert_allclose(sorted(found), radii)


def heights(geometry, T):
    """Return the lowest and the highest point of a body at `T` (4, 4) [m], in closed form."""
    up = T[2, :3]
    if isinstance(geometry, coal.Box):
        reach = np.abs(up) @ np.array(geometry.halfSide)
    elif isinstance(geometry, coal.Sphere):
        reach = geometry.radius
    else:
        reach = geometry.halfLength * abs(up[2]) + geometry.radius * np.hypot(up[0], up[1])
    return T[2, 3] - reach, T[2, 3] + reach


@pytest.mark.parametrize("name", ["nova2-w", "nova2-s1"])
@pytest.mark.parametrize("thickness", [0.05, 0.004])
def test_grasps_with_a_body_as_low_as_the_table_have_a_point_and_no_others(name, thickness):
    cell = load_workcell(name)
    cell = replace(cell, supports=(Support.table(0.03, cell.table.center, cell.table.size, thickness),))
    model = load_object("mug")
    grasps, effector = sample_grasps(model, cell.end_effector, 12, seed=3), cell.end_effector
    raised = [translation(0.1, 0.0, z) @ p.pose for p in model.placements for z in (-0.1, 0.0, 0.06)]
    points = points_in_table(cell, grasps, np.array(raised))
    low, high = 0.03 - thickness, 0.03
    for s, g in np.ndindex(len(raised), len(grasps)):
        T = raised[s] @ grasps.T_object_tcp[g] @ effector.T_tcp_flange
        shapes = [*effector.body, *effector.finger_boxes(float(grasps.width[g]), effector.pre_opening)]
        bodies = [(shape_geometry(shape), T @ shape.pose, cell.clearance.gripper) for shape in shapes]
        bodies += [(geometry, T @ pose, cell.clearance.arm) for geometry, pose in wrist_bodies(cell.robot)]
        within = []
        for geometry, pose, clearance in bodies:
            bottom, top = heights(geometry, pose)
            within.append(bottom < high + clearance and top >= low - 1e-12)
        assert np.isfinite(points[s, g]).all() == any(within)
    assert 0.1 < np.isfinite(points).mean() < 0.95


@pytest.mark.parametrize("thickness", [0.05, 0.004])
def test_a_mesh_of_the_gripper_is_in_the_table_where_its_lowest_point_is(thickness):
    """What lies between the lowest and the highest point of a mesh may be hollow."""
    cell, model = load_workcell("nova2-s1"), load_object("mug")
    tower = trimesh.creation.box((0.12, 0.08, 0.1))
    body = Mesh("tower", np.array(tower.vertices), np.array(tower.faces), translation(0.0, 0.0, 0.05))
    effector = replace(cell.end_effector, body=(body,))
    cell = replace(
        cell,
        arm=replace(cell.arm, end_effector=effector),
        supports=(Support.table(0.03, cell.table.center, cell.table.size, thickness),),
    )
    grasps = sample_grasps(model, load_workcell("nova2-s1").end_effector, 12, seed=3)
    raised = np.array([translation(0.1, 0.0, z) @ p.pose for p in model.placements for z in (-0.1, 0.0, 0.06)])
    T_world_flange = raised[:, None] @ grasps.T_object_tcp @ effector.T_tcp_flange
    corners = np.einsum("sgij,pj->sgpi", T_world_flange[..., :3, :3], surface_points(body))
    corners += T_world_flange[..., None, :3, 3]
    lowest = corners[..., 2].min(axis=2)
    expected = (lowest >= 0.03 - thickness) & (lowest < 0.03 + cell.clearance.gripper)
    bare = replace(cell, arm=replace(cell.arm, end_effector=replace(effector, body=())))
    alone = np.isnan(points_in_table(bare, grasps, raised)[..., 0])
    found = np.isfinite(points_in_table(cell, grasps, raised)).all(axis=2)
    assert 0 < expected[alone].mean() < 1  # where the wrist is above the table
    np.testing.assert_array_equal(found, expected | ~alone)


@pytest.mark.parametrize(
    "geometry",
    [coal.Box(0.1, 0.2, 0.3), coal.Sphere(0.1), coal.Capsule(0.05, 0.2), coal.Cylinder(0.05, 0.2), "mesh"],
    ids=["box", "sphere", "capsule", "cylinder", "mesh"],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_extreme_point_of_a_body_is_that_of_its_surface(geometry, sign):
    if geometry == "mesh":
        mug = load_object("mug")
        geometry = mesh_geometry(mug.vertices, mug.faces)
    poses = random_transforms(np.random.default_rng(0), 20)
    points = _extreme(geometry, poses, sign)
    for T, point in zip(poses, points, strict=True):
        local = T[:3, :3].T @ (point - T[:3, 3])
        surface = coal.CollisionObject(geometry)
        result = coal.DistanceResult()
        coal.distance(surface, coal.CollisionObject(coal.Sphere(1e-9), coal.Transform3s(np.eye(3), local)),
                      coal.DistanceRequest(), result)  # fmt: skip
        assert abs(result.min_distance) < 1e-5
        direction = sign * T[2, :3]
        far = 10.0 * direction
        result = coal.DistanceResult()
        wall = coal.Halfspace(-direction, -float(direction @ far))
        coal.distance(coal.CollisionObject(wall), surface, coal.DistanceRequest(), result)
        assert 10.0 - result.min_distance == pytest.approx(direction @ local, abs=1e-5)
