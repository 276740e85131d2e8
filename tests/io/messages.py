"""ROS 2 messages made of YAML by rosbags: what is not a field of the message, or not of its type, is refused."""

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITIONS = {
    "control_msgs/msg/GripperCommand": "float64 position; float64 max_effort",
    "object_recognition_msgs/msg/ObjectType": "string key; string db",
    "octomap_msgs/msg/Octomap": "std_msgs/Header header; bool binary; string id; float64 resolution; int8[] data",
    "octomap_msgs/msg/OctomapWithPose": "std_msgs/Header header; geometry_msgs/Pose origin; Octomap octomap",
    "moveit_msgs/msg/CollisionObject": "std_msgs/Header header; geometry_msgs/Pose pose; string id; "
    "object_recognition_msgs/ObjectType type; shape_msgs/SolidPrimitive[] primitives; "
    "geometry_msgs/Pose[] primitive_poses; shape_msgs/Mesh[] meshes; geometry_msgs/Pose[] mesh_poses; "
    "shape_msgs/Plane[] planes; geometry_msgs/Pose[] plane_poses; string[] subframe_names; "
    "geometry_msgs/Pose[] subframe_poses; byte operation",
    "moveit_msgs/msg/AttachedCollisionObject": "string link_name; CollisionObject object; string[] touch_links; "
    "trajectory_msgs/JointTrajectory detach_posture; float64 weight",
    "moveit_msgs/msg/RobotState": "sensor_msgs/JointState joint_state; "
    "sensor_msgs/MultiDOFJointState multi_dof_joint_state; AttachedCollisionObject[] attached_collision_objects; "
    "bool is_diff",
    "moveit_msgs/msg/AllowedCollisionEntry": "bool[] enabled",
    "moveit_msgs/msg/AllowedCollisionMatrix": "string[] entry_names; AllowedCollisionEntry[] entry_values; "
    "string[] default_entry_names; bool[] default_entry_values",
    "moveit_msgs/msg/LinkPadding": "string link_name; float64 padding",
    "moveit_msgs/msg/LinkScale": "string link_name; float64 scale",
    "moveit_msgs/msg/ObjectColor": "string id; std_msgs/ColorRGBA color",
    "moveit_msgs/msg/PlanningSceneWorld": "CollisionObject[] collision_objects; octomap_msgs/OctomapWithPose octomap",
    "moveit_msgs/msg/PlanningScene": "string name; RobotState robot_state; string robot_model_name; "
    "geometry_msgs/TransformStamped[] fixed_frame_transforms; AllowedCollisionMatrix allowed_collision_matrix; "
    "LinkPadding[] link_padding; LinkScale[] link_scale; ObjectColor[] object_colors; PlanningSceneWorld world; "
    "bool is_diff",
}
"""The fields of messages that do not come with rosbags, by the messages' public specifications."""

STORE = get_typestore(Stores.ROS2_HUMBLE)
for _name, _fields in DEFINITIONS.items():
    STORE.register(get_types_from_msg(_fields.replace("; ", "\n"), _name))

ZERO = {"string": "", "bool": False, "float64": 0.0, "float32": 0.0}


def received(kind, content):
    """Return the message of type `kind` that `content` is, once it was written as CDR and read again."""
    return STORE.deserialize_cdr(STORE.serialize_cdr(_message(kind, content), kind), kind)


def _message(kind, content):
    fields = dict(STORE.fielddefs[kind][1])
    assert not set(content) - set(fields), f"{kind} has no {set(content) - set(fields)}"
    return STORE.types[kind](**{name: _value(node, content.get(name)) for name, node in fields.items()})


def _value(node, content):
    shape, inner = node
    if shape is Nodetype.NAME:
        return _message(inner, content or {})
    if shape is Nodetype.BASE:
        return ZERO.get(inner[0], 0) if content is None else content
    (item, count), (of, about) = inner, inner[0]
    if content is None:
        content = [0] * count if shape is Nodetype.ARRAY else []
    if of is Nodetype.BASE and about[0] != "string":
        import numpy as np

        values = np.array(content, dtype={"bool": bool, "octet": np.uint8}.get(about[0], about[0]))
        assert values.tolist() == list(content), "rounded"
        return values
    return [_value(item, each) for each in content]
