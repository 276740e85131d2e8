"""Xacro files are read as the URDF that they make."""

import builtins

import pytest
import trimesh
from arms import arm_urdf

from regrasp_opt.errors import WorkcellError
from regrasp_opt.robots import load_robot

pytest.importorskip("xacrodoc")

ARM = arm_urdf([("revolute", "0 0 0.3", "0 0 0", "0 1 0", (-2, 2))] * 6)
BODY = "<collision><geometry><mesh filename='package://my_meshes/base.stl'/></geometry></collision>"
PARTS = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="reach" value="0.3"/></robot>'


@pytest.fixture
def workspace(tmp_path):
    """Return the xacro file of a package whose folder has another name; it includes and uses a package beside it."""
    for folder, name in (("arm-main", "my_arm"), ("meshes-main", "my_meshes")):
        (tmp_path / folder / "urdf").mkdir(parents=True)
        (tmp_path / folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "meshes-main" / "base.stl")
    (tmp_path / "meshes-main" / "urdf" / "parts.xacro").write_text(PARTS)
    text = ARM.replace(
        "<robot name='arm'>",
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="limit" default="2"/>'
        '<xacro:include filename="$(find my_meshes)/urdf/parts.xacro"/>',
    )
    text = text.replace("<link name='link0'></link>", f"<link name='link0'>{BODY}</link>")
    text = text.replace("0 0 0.3", "0 0 ${reach}").replace("upper='2'", "upper='$(arg limit)'")
    path = tmp_path / "arm-main" / "urdf" / "arm.urdf.xacro"
    path.write_text(text)
    return path


def test_a_xacro_is_the_urdf_that_it_makes(workspace, tmp_path):
    (tmp_path / "plain.urdf").write_text(ARM)
    robot, plain = load_robot(workspace), load_robot(tmp_path / "plain.urdf")
    assert robot.upper.tolist() == [2.0] * 6 and robot.collision.ngeoms == 1
    assert (robot.forward(plain.home) == plain.forward(plain.home)).all()
    assert load_robot(str(workspace), xacro_args={"limit": "1.5"}).upper.tolist() == [1.5] * 6


def refusal(path, **options):
    with pytest.raises(WorkcellError) as info:
        load_robot(path, **options)
    assert "\n" not in str(info.value)
    return str(info.value)


def test_what_xacro_says_is_passed_on(workspace, tmp_path, capfd):
    text = workspace.read_text()
    workspace.write_text(text.replace("${reach}", "${raech}", 1))
    assert "cannot be expanded: name 'raech' is not defined" in refusal(workspace)
    workspace.write_text(text.replace("find my_meshes", "find your_meshes"))
    assert "cannot be expanded: " in refusal(workspace) and "your_meshes" in refusal(workspace)
    workspace.write_text(text.replace("</robot>", ""))
    assert "cannot be expanded: " in refusal(workspace)
    assert "arm.xacro cannot be expanded" in refusal(tmp_path / "arm.xacro")
    (tmp_path / "plain.urdf").write_text(ARM)
    assert "is not a .xacro file, so xacro_args mean nothing" in refusal(tmp_path / "plain.urdf", xacro_args={"a": "1"})
    assert capfd.readouterr().err == ""


PLAIN_NAME = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def test_arguments_that_the_file_does_not_have_are_refused(workspace, tmp_path):
    said = refusal(workspace, xacro_args={"limt": "1.5"})
    assert said.endswith("arm.urdf.xacro has no argument 'limt' to give in xacro_args; known: limit")
    parts = tmp_path / "meshes-main" / "urdf" / "parts.xacro"
    inner = '<xacro:arg name="reach" default="0.3"/><xacro:property name="reach" value="$(arg reach)"/></robot>'
    parts.write_text(PARTS.replace('<xacro:property name="reach" value="0.3"/></robot>', inner))
    robot = load_robot(workspace, xacro_args={"reach": "0.4", "limit": "1.5"})
    assert robot.upper[0] == 1.5 and robot.chain.placements[1, 2, 3] == 0.4
    said = refusal(workspace, xacro_args={"limit": "1", "rech": "0.4"})
    assert said.endswith("'rech' to give in xacro_args; known: reach, limit")
    bare = tmp_path / "bare.xacro"
    bare.write_text(ARM.replace("<robot name='arm'>", PLAIN_NAME))
    assert refusal(bare, xacro_args={"limit": "1"}).endswith("it has none; leave xacro_args out")


def test_an_argument_that_is_used_without_being_declared_may_be_given(tmp_path):
    bare = tmp_path / "bare.xacro"
    bare.write_text(ARM.replace("<robot name='arm'>", PLAIN_NAME).replace("upper='2'", "upper='$(arg limit)'"))
    assert load_robot(bare, xacro_args={"limit": "1.5"}).upper.tolist() == [1.5] * 6


def test_the_extra_is_named_where_it_is_missing(workspace, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "xacrodoc":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    assert "is a xacro file; install the extra regrasp-opt[robots]" in refusal(workspace)
