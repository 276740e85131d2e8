"""Bodies: every collision element is one or is refused by name, and which of them are tested against each other."""

import logging

import coal
import numpy as np
import pytest
import trimesh
from arms import arm_urdf

from regrasp_opt.conventions import rotation_rpy
from regrasp_opt.errors import WorkcellError
from regrasp_opt.robots import load_robot

JOINT = ("revolute", "0 0 0.3", "0 0 0", "0 1 0", (-2, 2))
GOOD = {
    "<box size='0.1 0.2 0.3'/>": (coal.Box, [0.1, 0.2, 0.3]),
    "<sphere radius='0.1'/>": (coal.Sphere, [0.2, 0.2, 0.2]),
    "<cylinder radius='0.1' length='0.5'/>": (coal.Cylinder, [0.2, 0.2, 0.5]),
    "<capsule radius='0.1' length='0.5'/>": (coal.Capsule, [0.2, 0.2, 0.7]),
    "<mesh filename='part.stl'/>": (coal.BVHModelOBBRSS, [0.1, 0.2, 0.3]),
    "<mesh filename='part.stl' scale='0.1 -0.2 0.3'/>": (coal.BVHModelOBBRSS, [0.01, 0.04, 0.09]),
    "<mesh filename='part.obj' scale=' 2 2  2 '/>": (coal.BVHModelOBBRSS, [0.2, 0.4, 0.6]),
}
BAD = {
    "<box size='0.1 0.1'/>": ': <box> has size="0.1 0.1"; give 3 numbers',
    "<box size='0.1 0.1 zero'/>": ': <box> has size="0.1 0.1 zero"; give 3 numbers',
    "<box size='0.1 0.1 nan'/>": ': <box> has size="0.1 0.1 nan"; give 3 numbers',
    "<box size='0.1 0.1 0'/>": ": the box has a size that is not positive; give its sizes in metres",
    "<box/>": ": <box> lacks size; give 3 numbers",
    "<sphere/>": ": <sphere> lacks radius; give a number",
    "<sphere radius=''/>": ': <sphere> has radius=""; give a number',
    "<sphere radius='-0.1'/>": ": the sphere has a size that is not positive; give its sizes in metres",
    "<cylinder radius='0.1'/>": ": <cylinder> lacks length; give a number",
    "<cylinder radius='0.1 0.2' length='1'/>": ': <cylinder> has radius="0.1 0.2"; give a number',
    "<capsule length='1'/>": ": <capsule> lacks radius; give a number",
    "<capsule radius='0.1' length='inf'/>": ': <capsule> has length="inf"; give a number',
    "<cone radius='0.1' length='1'/>": " is a <cone>; use box, cylinder, capsule, sphere or mesh",
    "<mesh filename='part.stl' scale='0.001'/>": ': <mesh> has scale="0.001"; give 3 numbers',
    "<mesh filename='part.stl' scale='1 0 1'/>": " has a mesh of scale 0; give the factor to metres",
    "<mesh filename='empty.stl'/>": ": its mesh cannot be used: ",
    "<mesh filename='broken.3ds'/>": "is not a mesh file that can be read; give one of",
    "": " has 0 shapes; give it one <geometry> with one shape",
    "<sphere radius='0.1'/><box size='1 1 1'/>": " has 2 shapes; give it one <geometry> with one shape",
}


@pytest.fixture
def arm_with(tmp_path):
    """Return a function that writes an arm of two joints whose middle link has the bodies that are given."""
    for name in ("part.stl", "part.obj"):
        trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / name)
    for name in ("empty.stl", "broken.3ds"):
        (tmp_path / name).write_bytes(b"")

    def write(*bodies, origin=""):
        elements = "".join(f"<collision>{origin}<geometry>{body}</geometry></collision>" for body in bodies)
        text = arm_urdf([JOINT, JOINT])
        assert "<link name='link1'/>" in text
        path = tmp_path / "arm.urdf"
        path.write_text(text.replace("<link name='link1'/>", f"<link name='link1'>{elements}</link>"))
        return path

    return write


@pytest.mark.parametrize("body", GOOD)
def test_every_shape_becomes_a_body_of_its_size(arm_with, body):
    kind, extents = GOOD[body]
    origin = "<origin xyz='1 2 3' rpy='0.1 0.2 0.3'/>"
    robot = load_robot(arm_with("<sphere radius='0.01'/>", body, body, origin=origin))
    bodies = robot.collision.geometryObjects
    assert [item.parentJoint for item in bodies] == [1, 1, 1]
    assert [robot.link_of(i) for i in range(3)] == ["link1"] * 3
    geometry = bodies[2].geometry
    assert isinstance(geometry, kind)
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    np.testing.assert_allclose(np.array(box.max_) - np.array(box.min_), extents, atol=1e-6)
    np.testing.assert_allclose(bodies[2].placement.rotation, rotation_rpy(0.1, 0.2, 0.3), atol=1e-15)
    np.testing.assert_array_equal(bodies[2].placement.translation, [1, 2, 3])


def test_mirrored_meshes_keep_their_outside(arm_with):
    for scale in ("1 1 1", "-1 1 1", "-1 -1 1"):
        robot = load_robot(arm_with(f"<mesh filename='part.stl' scale='{scale}'/>"))
        mesh = robot.collision.geometryObjects[0].geometry
        faces = [[int(mesh.tri_indices(i)[k]) for k in range(3)] for i in range(mesh.num_tris)]
        assert trimesh.Trimesh(np.array(mesh.vertices()), faces, process=False).volume == pytest.approx(0.006)


def test_turns_may_be_quaternions(arm_with):
    robot = load_robot(arm_with("<box size='0.1 0.2 0.3'/>", origin="<origin quat_xyzw='0 0 2 2'/>"))
    turned = robot.collision.geometryObjects[0].placement.rotation
    np.testing.assert_allclose(turned, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize("body", BAD)
def test_bodies_that_cannot_be_read_are_named(arm_with, body, capfd):
    with pytest.raises(WorkcellError) as info:
        load_robot(arm_with("<sphere radius='0.01'/>", body))
    said = str(info.value)
    assert "link 'link1', <collision> number 2" in said and BAD[body] in said
    assert "\n" not in said and capfd.readouterr().err == ""


@pytest.mark.parametrize("origin", ["xyz='0 0'", "xyz='0 0 x'", "rpy='1'", "rpy='0 0 inf'", "quat_xyzw='0 0 1'"])
def test_places_that_cannot_be_read_are_named(arm_with, origin):
    with pytest.raises(WorkcellError, match="link 'link1', <collision> number 1: <origin> has "):
        load_robot(arm_with("<sphere radius='0.01'/>", origin=f"<origin {origin}/>"))


BALL = "<collision><geometry><sphere radius='0.01'/></geometry></collision>"


def tree(*rows, bare=()):
    """Return a URDF of joints (type, parent, child); each link has a body, but those in `bare`."""
    links = dict.fromkeys(name for _, *pair in rows for name in pair)
    text = "".join(f"<link name='{name}'>{'' if name in bare else BALL}</link>" for name in links)
    for kind, parent, child in rows:
        limit = "" if kind == "fixed" else "<limit lower='-1' upper='1' velocity='1' effort='1'/>"
        text += f"<joint name='to_{child}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        text += f"<axis xyz='0 0 1'/>{limit}</joint>"
    return f"<robot name='tree'>{text}</robot>"


TORSO = [
    ("fixed", "world", "pedestal"),
    ("prismatic", "pedestal", "torso"),
    ("fixed", "torso", "head"),
    ("revolute", "torso", "left1"),
    ("revolute", "left1", "left2"),
    ("revolute", "torso", "arm1"),
    ("revolute", "arm1", "arm2"),
    ("fixed", "arm2", "hand"),
    ("prismatic", "hand", "finger"),
    ("fixed", "pedestal", "shelf"),
]


def links_tested(robot):
    return {frozenset((robot.link_of(i), robot.link_of(j))) for i, j in robot.self_collision_pairs()}


def pairs(*texts):
    return {frozenset(text.split("-")) for text in texts}


def test_whatever_moves_otherwise_is_tested_but_for_what_a_joint_connects(tmp_path):
    path = tmp_path / "torso.urdf"
    path.write_text(tree(*TORSO))
    robot = load_robot(path, tip="hand")
    groups = [["world", "pedestal", "shelf"], ["torso", "head", "left1", "left2"], ["arm1"], ["arm2", "hand", "finger"]]
    apart = {frozenset((a, b)) for i, one in enumerate(groups) for other in groups[:i] for a in one for b in other}
    assert links_tested(robot) == apart - pairs("pedestal-torso", "torso-arm1", "arm1-arm2")
    assert {robot.link_of(i) for i in robot.obstacles} == {"world", "shelf"}
    ignoring = load_robot(path, tip="hand", ignore_collisions=[("head", "arm1"), ("shelf", "finger")])
    assert links_tested(ignoring) == links_tested(robot) - pairs("head-arm1", "shelf-finger")


def test_a_body_before_an_empty_link_of_the_first_joint_is_an_obstacle(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(tree(("fixed", "foot", "mount"), ("revolute", "mount", "arm1"), bare=["mount"]))
    robot = load_robot(path)
    assert links_tested(robot) == pairs("foot-arm1") and len(robot.obstacles) == 1


def said_on_loading(path, caplog, **options):
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        load_robot(path, **options)
    return [record.getMessage() for record in caplog.records]


def test_what_has_no_body_is_said_in_one_line(tmp_path, caplog):
    path = tmp_path / "arm.urdf"
    rows = [("revolute", "base", "a"), ("revolute", "a", "b"), ("fixed", "b", "cover"), ("fixed", "cover", "tool0")]
    path.write_text(tree(*rows, bare=["tool0"]))
    assert said_on_loading(path, caplog) == []
    path.write_text(tree(*rows, bare=["base", "a", "b", "tool0"]))  # the cover is the body of b
    [said] = said_on_loading(path, caplog)
    assert "no <collision> element in a; what has none" in said
    seen = BALL.replace("collision", "visual")
    text = tree(*rows, bare=["tool0", "b"]).replace("<link name='b'>", f"<link name='b'>{seen}")
    path.write_text(text.replace("<link name='base'>", f"<link name='base'>{seen}"))
    [said] = said_on_loading(path, caplog)
    assert "no <collision> element in b; what has none" in said
    path.write_text(tree(*rows, bare=["base", "a", "b", "cover", "tool0"]))
    [said] = said_on_loading(path, caplog)
    assert said == f"{path} has no <collision> element; no part of the arm is tested for collision"
    path.write_text(tree(*rows, bare=["a", "b", "cover", "tool0"]))
    [said] = said_on_loading(path, caplog)
    assert said == f"{path} has no <collision> element in a, b; what has none is not tested for collision"
    chain = [("revolute", f"l{k}", f"l{k + 1}") for k in range(8)]
    path.write_text(tree(*chain, bare=[f"l{k}" for k in range(1, 9)]))
    [said] = said_on_loading(path, caplog)
    assert "in l1, l2, l3, l4, l5 and 3 more links" in said
