"""What URDF files in use look like: lenient XML, limits that are missing or in degrees, meshes of packages."""

import logging
import math

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from arms import arm_urdf

from regrasp_opt.errors import WorkcellError
from regrasp_opt.robots import load_robot

BODY = "<collision><geometry><mesh filename='{}'/></geometry></collision>"
PLAIN = arm_urdf([("revolute", "0 0 0.3", "0 0 0", "0 1 0", (-2, 2))] * 2)


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(path, **options):
    with pytest.raises(WorkcellError) as info:
        load_robot(path, **options)
    assert "\n" not in str(info.value)
    return str(info.value)


LENIENT = {
    "no robot name": PLAIN.replace(" name='arm'", ""),
    "no effort": PLAIN.replace(" effort='1'", ""),
    "a prefix nobody declared": PLAIN.replace("</robot>", "<xacro:property name='a' value='1'/></robot>"),
    "a prefixed attribute": PLAIN.replace("<robot ", "<robot xsi:schemaLocation='a b' "),
    "a namespace": PLAIN.replace("<robot ", "<robot xmlns='http://www.ros.org' "),
    "dashes in a comment": PLAIN.replace("<link", "<!-- -- base -- --><link", 1),
    "a blank line first": "\n  <?xml version='1.0'?>" + PLAIN,
    "a byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "a version": PLAIN.replace("<robot ", "<robot version='1.1' "),
    "a broken visual": PLAIN.replace("<link name='link1'/>", "<link name='link1'><visual><geometry/></visual></link>"),
    "half a safety controller": PLAIN.replace("<axis", "<safety_controller soft_lower_limit='-1'/><axis"),
    "a mimic beside the arm": PLAIN.replace(
        "</robot>",
        "<link name='x'/><joint name='x' type='revolute'><parent link='link1'/><child link='x'/><mimic joint='j1'/>"
        "</joint></robot>",
    ),
}


@pytest.mark.parametrize("name", LENIENT)
def test_what_urdfdom_reads_is_read(tmp_path, name):
    robot = load_robot(write(tmp_path / "own.urdf", LENIENT[name]), tip="link2")
    assert (robot.dof, robot.upper.tolist()) == (2, [2, 2])
    assert robot.name == ("own" if name == "no robot name" else "arm")


def test_what_the_parser_says_is_passed_on(tmp_path, capfd):
    for text, said in (
        (PLAIN.replace("<robot ", "<robot version='7.0' "), "Pinocchio can read: Invalid 'version' specified"),
        (PLAIN.replace("0 0 0.3", "0 zero 0.3"), "Unable to parse component [zero] to a double"),
        (PLAIN.replace("'j2'", "'j1'"), "j1"),
        (PLAIN.replace("<link name='link1'/>", "<link name='link1'/>" * 2), "link1"),
        (PLAIN.replace("</link>", "</lonk>", 1), "not valid XML: mismatched tag: line 1"),
        ("<!--\n\n-->\n<robot><", "not valid XML: unclosed token: line 4"),
        (PLAIN.replace("'0 1 0'", "'0 0 0'", 1), "joint 'j1' has no axis"),
    ):
        assert said in refusal(write(tmp_path / "arm.urdf", text)), said
    assert capfd.readouterr().err == ""


def said_of(path, caplog, **options):
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        robot = load_robot(path, **options)
    return robot, [text for text in (r.getMessage() for r in caplog.records) if "<collision>" not in text]


def test_a_speed_that_is_missing_is_assumed_and_said(tmp_path, caplog):
    rows = [("revolute", (-2, 2)), ("prismatic", (-0.1, 0.1)), ("revolute", (-2, 2)), ("continuous", None)]
    text = arm_urdf([(kind, "0 0 0.3", "0 0 0", "0 1 0", limits) for kind, limits in rows])
    silent = text.replace("velocity='1' ", "", 2)
    robot, [said] = said_of(write(tmp_path / "arm.urdf", silent), caplog)
    assert "states no velocity limit (j1, j2, j4); 3.14 rad/s is assumed for turning and 0.25 m/s for sliding" in said
    np.testing.assert_array_equal(robot.velocity_limits, [math.pi, 0.25, 1, math.pi])
    stated = text.replace("</joint></robot>", "<limit velocity='2' effort='1'/></joint></robot>")
    robot, said = said_of(write(tmp_path / "arm.urdf", stated), caplog)
    assert robot.velocity_limits.tolist() == [1, 1, 1, 2] and said == []
    assert "j1' has a velocity limit that is not a finite number" in refusal(
        write(tmp_path / "arm.urdf", text.replace("velocity='1'", "velocity='fast'", 1))
    )


@pytest.mark.parametrize(
    ("kind", "speed", "fast"),
    [
        ("revolute", 180, True),
        ("revolute", 30, True),
        ("revolute", 17.5, False),
        ("continuous", 90, True),
        ("continuous", 10, False),
        ("prismatic", 250, True),
        ("prismatic", 5, False),
    ],
)
def test_speeds_that_may_be_degrees_or_millimetres_are_said_once(tmp_path, caplog, kind, speed, fast):
    text = arm_urdf([(kind, "0 0 0.3", "0 0 0", "0 1 0", (-0.2, 0.2))] * 3)
    path = write(tmp_path / "arm.urdf", text.replace("velocity='1'", f"velocity='{speed}'", 2))
    robot, said = said_of(path, caplog)
    assert robot.velocity_limits.tolist() == [speed, speed, 1] and len(said) == fast
    for line in said:
        assert f"faster than 20 rad/s or 10 m/s (j1 at {speed}, j2 at {speed}); if their URDF has degrees" in line


@pytest.mark.parametrize(
    ("limits", "reading"),
    [
        ((-12.57, 12.57), "radians"),
        ((-6.98, 6.98), "radians"),
        ((-18.85, 18.85), "doubt"),
        ((0, 14.5), "doubt"),
        ((-20 * math.pi, 20 * math.pi), "doubt"),
        ((-360, 360), "degrees"),
        ((-170, 170), "degrees"),
        ((-175, 0), "degrees"),
        ((-45, 45.5), "doubt"),
        ((-147.5, 147.5), "degrees"),
        ((-1e16, 1e16), "degrees"),
    ],
)
def test_limits_beyond_two_turns_may_be_degrees(tmp_path, caplog, limits, reading):
    joint = ("revolute", "0 0 0.3", "0 0 0", "0 1 0")
    path = write(tmp_path / "arm.urdf", arm_urdf([(*joint, (-2, 2)), (*joint, limits)]))
    if reading == "degrees":
        low, high = (f"{math.radians(x):.4g}" for x in limits)
        assert f"joint 'j2' turns from {limits[0]:g} to {limits[1]:g} rad: are these degrees? Give" in refusal(path)
        assert f'Give radians ({low} to {high}), or type="continuous"' in refusal(path)
    else:
        robot, said = said_of(path, caplog)
        assert len(said) == (reading == "doubt") and robot.upper[1] == limits[1]
        assert all("may turn by more than two turns (j2); if their limits are degrees, give radians" in s for s in said)


def test_strokes_in_millimetres_are_refused(tmp_path):
    text = arm_urdf([("prismatic", "0 0 0.3", "0 0 0", "0 1 0", (0, 400))])
    assert "joint 'j1' slides from 0 to 400 m; give its limits in metres" in refusal(write(tmp_path / "a.urdf", text))


QUATERNIONS = [[0, 0, 0.7071068, 0.7071068], [0, 0, -3, 3], [0, 1, 0, 1], [1e-5, 1, 0, 1], [1, 1, 1, 1], [1, 0, 0, 0]]


@pytest.mark.parametrize("turn", [*QUATERNIONS, *np.random.default_rng(0).normal(size=(5, 4)).tolist()])
@pytest.mark.parametrize("kind", ["revolute", "fixed"])
def test_joints_turn_by_their_quaternions(tmp_path, turn, kind):
    rows = [("revolute", (-2, 2)), (kind, (-2, 2)), ("revolute", (-2, 2))]
    text = arm_urdf([(kind, "0 0 0.3", "0 0 0", "0 1 0", limits) for kind, limits in rows])
    given = " ".join(map(repr, turn))
    second = text.index("rpy", text.index("'j2'"))
    text = text[:second] + text[second:].replace("rpy='0 0 0'", f"quat_xyzw='{given}'", 1)
    robot = load_robot(write(tmp_path / "arm.urdf", text))
    expected = pin.Quaternion(turn[3], *turn[:3]).normalized().matrix()
    np.testing.assert_allclose(robot.forward(np.zeros(robot.dof))[:3, :3], expected, atol=1e-9)
    assert b"quat_xyzw" not in robot.urdf  # what is exported is read by others


@pytest.mark.parametrize("turn", ["", "0 0 1", "0 0 0 1 0", "0 0 0 one", "0 0 0 0", "0 0 nan 1", "0 0 inf 1"])
def test_malformed_quaternions_are_refused(tmp_path, turn):
    text = PLAIN.replace("rpy='0 0 0'", f"quat_xyzw='{turn}'", 1)
    said = refusal(write(tmp_path / "arm.urdf", text))
    assert f"joint 'j1': <origin> has quat_xyzw=\"{turn}\"; give 4 numbers that are not all zero" in said


@pytest.fixture
def workspace(tmp_path):
    """A package whose folder has another name, with the URDF of another package that has its mesh."""
    parts = tmp_path / "src" / "Parts_ROS2"
    write(parts / "package.xml", "<?xml version='1.0'?><package format='3'><name> parts </name></package>")
    (parts / "meshes").mkdir()
    trimesh.creation.box((0.1, 0.1, 0.1)).export(parts / "meshes" / "a b.stl")
    return tmp_path / "src"


def arm_of(workspace, mesh, folder="arm/urdf"):
    text = PLAIN.replace("<link name='link1'/>", f"<link name='link1'>{BODY.format(mesh)}</link>")
    return write(workspace / folder / "arm.urdf", text)


MESH = "package://parts/meshes/a b.stl"


@pytest.mark.parametrize("given", ["Parts_ROS2", ".", "../src"])
def test_a_package_is_found_by_its_name_among_the_folders_given(workspace, given):
    robot = load_robot(arm_of(workspace, MESH), package_dirs=[workspace / given])
    assert robot.collision.ngeoms == 1 and str(workspace).encode() in robot.urdf


@pytest.mark.parametrize(
    "mesh",
    [
        MESH,
        MESH.replace("package", "model"),
        "package://Parts_ROS2/meshes/a b.stl",
        "../meshes/a b.stl",
        "file://{}/meshes/a%20b.stl",
        "file://localhost{}/meshes/a b.stl",
        "{}/meshes/a b.stl",
        "package:///src/Parts_ROS2/meshes/a b.stl",
    ],
)
def test_a_mesh_is_found_from_a_file_in_the_package_itself(workspace, mesh, monkeypatch):
    monkeypatch.chdir("/")
    path = arm_of(workspace, mesh.format(workspace / "Parts_ROS2"), "Parts_ROS2/urdf")
    assert load_robot(path).collision.ngeoms == 1


def test_where_a_mesh_was_looked_for_is_said(workspace):
    said = refusal(arm_of(workspace, MESH))
    assert f"mesh '{MESH}' is not found; looked for package 'parts' in the folders above the URDF file" in said
    assert "add to package_dirs the folder whose package.xml says <name>parts</name>, or the one that holds it" in said
    said = refusal(arm_of(workspace, MESH), package_dirs=[workspace / "arm", "gone"])
    assert f"looked for package 'parts' in '{workspace / 'arm'}', in what is directly in it, and in 'gone', in" in said
    said = refusal(arm_of(workspace, MESH + "x"), package_dirs=[workspace])
    assert f"package 'parts' is '{workspace / 'Parts_ROS2'}', without 'meshes/a b.stlx'" in said
    said = refusal(arm_of(workspace, "meshes/a.stl"))
    assert f"there is no file '{workspace / 'arm/urdf/meshes/a.stl'}'" in said
    for name in ("http://a/b.stl", "package://parts", ""):
        assert f"mesh '{name}' is not found; " in refusal(arm_of(workspace, name))
