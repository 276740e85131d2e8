"""Planning scenes, read as messages by rosbags and put together by Pinocchio: where everything is, who may touch."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yaml
from messages import received
from oracles.files import DATA
from scipy.spatial.transform import Rotation

from regrasp_opt.errors import PlanFileError
from regrasp_opt.io.moveit_export import planning_scenes, save_moveit
from regrasp_opt.motion import MotionPlan, MotionStatus, Phase
from regrasp_opt.scene import load_workcell
from regrasp_opt.scene.support import Support

CELL = """
[[obstacles]]
type = "cylinder"
name = "post"
radius = 0.02
length = 0.3
position = [0.4, 0.5, 0.15]
[[obstacles]]
type = "mesh"
name = "object"
file = "part.stl"
position = [-0.4, 0.5, 0.1]
rpy = [0.0, 0.3, 0.5]
"""


@pytest.fixture(scope="module")
def scenes(motion, tmp_path_factory):
    """Return the motion in a workcell with a shelf and two obstacles, one named like the object, and its scenes."""
    folder = tmp_path_factory.mktemp("moveit")
    trimesh.creation.box((0.06, 0.06, 0.2)).export(folder / "part.stl")
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
    (folder / "cell.toml").write_text(text + CELL, encoding="utf-8")
    cell = load_workcell(folder / "cell.toml")
    shelf = Support.table(0.4, np.array([-0.5, 0.7]), np.array([0.2, 0.2]), 0.02, name="shelf")
    problem = replace(motion.plan.problem, workcell=replace(cell, supports=(*cell.supports, shelf)))
    moved = replace(motion, plan=replace(motion.plan, problem=problem))
    save_moveit(moved, folder / "scenes.yaml")
    documents = list(yaml.safe_load_all((folder / "scenes.yaml").read_text("utf-8")))
    return moved, [received("moveit_msgs/msg/PlanningScene", document) for document in documents]


def pose(message):
    p, q = message.position, message.orientation
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), (p.x, p.y, p.z)
    return T


def frames(motion, state):
    """Return the pose in the world of a link, by name, at the joint state of a scene."""
    arm = motion.plan.problem.workcell.arm
    model = pin.buildModelFromXML(arm.robot.urdf.decode())
    q = np.zeros(model.nq)
    for name, value in zip(state.name, state.position, strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = value
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return lambda link: arm.T_world_base @ data.oMf[model.getFrameId(link)].homogeneous


def test_the_object_is_where_the_plan_has_it(scenes):
    motion, found = scenes
    plan, at = motion.plan, []
    for scene in found:
        world = frames(motion, scene.robot_state.joint_state)
        carried = {a.object.id: a for a in scene.robot_state.attached_collision_objects}
        lying = {o.id: o for o in scene.world.collision_objects}
        assert ("object_" in carried) != ("object_" in lying)
        body = lying.get("object_") or carried["object_"].object
        T = world(body.header.frame_id) @ pose(body.pose) @ pose(body.mesh_poses[0])
        (mesh,) = body.meshes
        np.testing.assert_allclose([(v.x, v.y, v.z) for v in mesh.vertices], plan.problem.object.vertices, atol=1e-12)
        assert np.array_equal([t.vertex_indices for t in mesh.triangles], plan.problem.object.faces)
        at.append(T)
        for attached in carried.values():
            assert attached.link_name == attached.object.header.frame_id == "flange"
            assert set(attached.touch_links) == {"link6", "flange"} and not scene.is_diff
    numbers = [k for k in range(len(plan.transitions)) for _ in range(2)] + [-1]
    np.testing.assert_allclose(at, plan.poses[numbers], atol=1e-6)  # as near as the arm comes to it
    np.testing.assert_allclose(at[0::2], plan.poses, atol=1e-9)


def test_hand_and_object_fit_together_as_the_grasp_says(scenes):
    motion, found = scenes
    grasped = [s for s in motion.segments if s.phase is Phase.GRASP]
    for segment, scene in zip(grasped, found[1::2], strict=True):
        tool, held = (a.object for a in scene.robot_state.attached_collision_objects)
        problem = motion.plan.problem
        T = pose(tool.pose) @ problem.workcell.arm.end_effector.T_flange_tcp
        np.testing.assert_allclose(T, pose(held.pose) @ problem.grasps.T_object_tcp[segment.grasp_id], atol=1e-9)
        fingers = [pose(p)[1, 3] for p in tool.primitive_poses[-2:]]
        inner = (fingers[0] - fingers[1]) - tool.primitives[-1].dimensions[1]
        assert inner == pytest.approx(problem.grasps.width[segment.grasp_id], abs=1e-9)


def test_table_and_obstacles_are_those_of_the_workcell(scenes):
    motion, found = scenes
    cell = motion.plan.problem.workcell
    for scene in found:
        world = frames(motion, scene.robot_state.joint_state)
        fixed = {o.id: o for o in scene.world.collision_objects}
        for shape in (*(support.shape for support in cell.boards), *cell.obstacles):
            body = fixed[shape.name]
            inner = (body.primitive_poses + body.mesh_poses)[0]
            T = world(body.header.frame_id) @ pose(body.pose) @ pose(inner)
            np.testing.assert_allclose(T, shape.pose, atol=1e-9)
        assert fixed["table"].primitives[0].dimensions.tolist() == cell.table.shape.size.tolist()
        assert fixed["post"].primitives[0].type == 3 and fixed["post"].primitives[0].dimensions.tolist() == [0.3, 0.02]
        assert len(fixed["object"].meshes[0].triangles) == 12


def test_only_what_touches_by_design_may_touch(scenes):
    _, found = scenes
    for scene in found:
        matrix = scene.allowed_collision_matrix
        names = {name: k for k, name in enumerate(matrix.entry_names)}
        allowed = np.array([entry.enabled for entry in matrix.entry_values])
        assert np.array_equal(allowed, allowed.T) and allowed.shape == (len(names),) * 2
        held = "object_" in [a.object.id for a in scene.robot_state.attached_collision_objects]
        wanted = {
            ("link1", "link2"): True,
            ("link1", "link4"): False,
            ("link6", "gripper"): True,
            ("link3", "gripper"): False,
            ("base_link", "table"): True,
            ("link2", "table"): False,
            ("gripper", "table"): False,
            ("gripper", "post"): False,
            ("link4", "object"): False,
            ("object_", "table"): True,
            ("object_", "post"): not held,
            ("object_", "shelf"): not held,
            ("gripper", "shelf"): False,
            ("object_", "gripper"): held,
            ("object_", "link6"): held,
        }
        assert {(a, b): allowed[names[a], names[b]] for a, b in wanted} == wanted


def test_links_and_joints_are_those_of_the_robots_own_file(motion, tmp_path):
    urdf = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8")
    lift = (
        '<link name="pillar"/><joint name="lift" type="prismatic"><parent link="pillar"/><child link="base_link"/>'
        '<axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="1" effort="1"/></joint><link name="lid"/>'
        '<joint name="hinge" type="revolute"><parent link="pillar"/><child link="lid"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    (tmp_path / "arm.urdf").write_text(urdf.replace("</robot>", lift), encoding="utf-8")
    seat = "[robot]\ntip_position = [0.0, 0.01, 0.02]\ntip_rpy = [0.1, 0.2, 0.3]\nlocked = { lift = 0.2 }\n"
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8").replace('"nova2"', '"arm.urdf"')
    (tmp_path / "cell.toml").write_text(text.replace("[robot]\n", seat), encoding="utf-8")
    problem = replace(motion.plan.problem, workcell=load_workcell(tmp_path / "cell.toml"))
    scene = planning_scenes(replace(motion, plan=replace(motion.plan, problem=problem)))[1]
    state, robot = scene["robot_state"], problem.workcell.robot
    joints = dict(zip(state["joint_state"]["name"], state["joint_state"]["position"], strict=True))
    assert (joints["lift"], joints["hinge"]) == (0.2, 0.0) and robot.tip_frame == "flange_tool"
    model = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    assert set(joints) == set(list(model.names)[1:])
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array([joints[name] for name in list(model.names)[1:]]))
    T_tip = robot.forward([joints[name] for name in robot.joint_names])
    tool, held = state["attached_collision_objects"]
    for attached in (tool, held):
        links = {attached["link_name"], attached["object"]["header"]["frame_id"], *attached["touch_links"]}
        assert links == {"flange", "link6"}
    about = received("moveit_msgs/msg/CollisionObject", tool["object"])
    flange = data.oMf[model.getFrameId("flange")].homogeneous
    np.testing.assert_allclose(flange @ pose(about.pose), T_tip, atol=1e-9)
    about = received("moveit_msgs/msg/CollisionObject", held["object"])
    (grasp,) = {s.grasp_id for s in motion.segments if s.phase is Phase.GRASP and s.transition == 0}
    T_tcp = T_tip @ problem.workcell.arm.end_effector.T_flange_tcp
    np.testing.assert_allclose(flange @ pose(about.pose) @ problem.grasps.T_object_tcp[grasp], T_tcp, atol=1e-9)


def test_no_motion_is_refused(motion):
    unsolved = MotionPlan(MotionStatus.NO_MOTION, "blocked", motion.plan, (), *[np.ones(6)] * 2, 0.0)
    with pytest.raises(PlanFileError, match="blocked"):
        planning_scenes(unsolved)
