"""Obstacles from MoveIt's planning scenes and MuJoCo's models: the same bodies, read from each and seen by MuJoCo."""

from __future__ import annotations

import logging
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import scene_texts
import trimesh
import yaml
from oracles.files import DATA
from scene_texts import BODIES, Body, collision_object, mjcf, planning_scene, pose, scene_text
from scipy.spatial.transform import Rotation

from regrasp_opt.errors import OptionError, RegraspError, WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.io.scene_files import read_obstacles
from regrasp_opt.scene import load_workcell

T_OBJECT = pose((0.1, -0.2, 0.3), (0.4, 0.5, -0.6))


def saved(path: Path, content: Any) -> Path:
    """Write text, or YAML."""
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


@pytest.fixture(params=["new.scene", "old.scene", "scene.yaml", "world.yaml", "objects.yml", "model.xml"])
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a file of the bodies in each of the formats."""
    objects = [collision_object(body, T_object=T_OBJECT) for body in BODIES]
    content: dict[str, Any] = {
        "new.scene": scene_text(T_object=T_OBJECT),
        "old.scene": scene_text(old=True),
        "scene.yaml": planning_scene(objects),
        "world.yaml": {"collision_objects": objects},
        "objects.yml": objects,
        "model.xml": mjcf(),
    }
    BODIES[2].mesh.export(tmp_path / "bracket.obj", digits=12)  # type: ignore[union-attr]
    return saved(tmp_path / request.param, content[request.param])


def placed(shape: Shape) -> np.ndarray:
    """Return the vertices (V, 3) of a mesh in the world."""
    assert isinstance(shape, Mesh)
    return shape.vertices @ shape.pose[:3, :3].T + shape.pose[:3, 3]


def test_the_same_bodies_are_read_from_every_format(file: Path) -> None:
    crate, post, bracket, ball = read_obstacles(file)
    assert [shape.name for shape in (crate, post, bracket, ball)] == [body.name for body in BODIES]
    assert isinstance(crate, Box) and isinstance(post, Cylinder)
    for shape, body in ((crate, BODIES[0]), (post, BODIES[1]), (ball, BODIES[3])):
        np.testing.assert_allclose(shape.pose, body.T, atol=1e-9)
    np.testing.assert_allclose(crate.size, BODIES[0].size, atol=1e-12)
    np.testing.assert_allclose((post.radius, post.length), BODIES[1].size, atol=1e-12)
    mesh = BODIES[2].mesh
    assert mesh is not None and isinstance(bracket, Mesh)
    wanted = mesh.vertices @ BODIES[2].T[:3, :3].T + BODIES[2].T[:3, 3]
    tolerance = 1e-7 if file.suffix == ".xml" else 1e-9  # MuJoCo keeps vertices in single precision
    distance = np.linalg.norm(placed(bracket)[:, None] - wanted, axis=2)
    assert distance.min(axis=1).max() < tolerance and distance.min(axis=0).max() < tolerance
    volume = trimesh.Trimesh(bracket.vertices, bracket.faces).volume
    assert volume == pytest.approx(mesh.volume, rel=1e-5)


def world_mesh(shape: Shape) -> trimesh.Trimesh:
    """Return the surface of a shape in the world; of a cylinder a fine one."""
    if isinstance(shape, Box):
        surface = trimesh.creation.box(extents=shape.size)
    elif isinstance(shape, Cylinder):
        surface = trimesh.creation.cylinder(radius=shape.radius, height=shape.length, sections=2000)
    else:
        surface = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    return surface.apply_transform(shape.pose)


def test_what_is_read_from_every_format_is_where_mujoco_sees_it(file: Path, tmp_path: Path) -> None:
    """Rays that MuJoCo casts at its own reading of the bodies end on ours; enclosing ones begin up to 0.5 % before."""
    BODIES[2].mesh.export(tmp_path / "bracket.obj", digits=12)  # type: ignore[union-attr]
    model = mujoco.MjModel.from_xml_path(str(saved(tmp_path / "reference.xml", mjcf())))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rng, hits = np.random.default_rng(0), 0
    for number, shape in enumerate(read_obstacles(file)):
        surface, middle = world_mesh(shape), BODIES[number].T[:3, 3]
        for _ in range(40):
            origin = middle + rng.normal(size=3) * 0.4
            aim = surface.bounds[0] + rng.random(3) * np.ptp(surface.bounds, axis=0)
            direction = (aim - origin) / np.linalg.norm(aim - origin)
            if surface.contains([origin])[0]:
                continue
            theirs = mujoco.mj_rayMesh(model, data, number, origin, direction) if model.geom_type[number] == 7 else None
            if theirs is None:
                theirs = mujoco.mju_rayGeom(
                    data.geom_xpos[number], data.geom_xmat[number], model.geom_size[number], origin, direction,
                    model.geom_type[number],
                )  # fmt: skip
            found = surface.ray.intersects_location([origin], [direction])[0]
            ours = np.linalg.norm(found - origin, axis=1).min() if len(found) else -1.0
            theirs = float(np.ravel(theirs)[0])
            if BODIES[number].kind == "sphere":
                assert theirs < 0 or -1e-9 < theirs - ours < 0.02
            elif theirs > 0 and ours > 0:
                assert ours == pytest.approx(theirs, abs=1e-4)
            hits += theirs > 0
    assert hits > 60


def test_shapes_without_a_counterpart_are_enclosed_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    T = pose((0.1, 0.2, 0.3), (0.4, -0.2, 0.9))
    cone, ball = Body("cone", "cone", (0.05, 0.2), T), Body("ball", "sphere", (0.07,), T)
    rng = np.random.default_rng(0)
    unit = rng.normal(size=(4000, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    turn = 2 * np.pi * rng.random(4000)
    height = rng.random(4000)
    on_cone = np.column_stack(
        [0.05 * (1 - height) * np.cos(turn), 0.05 * (1 - height) * np.sin(turn), 0.2 * (height - 0.5)]
    )
    x, y, z = T[:3, 3]
    axes = " ".join(repr(float(value)) for value in (*T[:3, 0], *T[:3, 1]))
    place = f'pos="{x} {y} {z}" xyaxes="{axes}"'
    model = (
        f'<mujoco><worldbody><geom name="pill" type="capsule" size="0.04 0.1" {place}/>'
        f'<geom name="egg" type="ellipsoid" size="0.03 0.05 0.1" {place}/></worldbody></mujoco>'
    )
    cases = {
        "a.scene": (scene_text((cone, ball)), {"cone": on_cone, "ball": 0.07 * unit}),
        "b.yaml": ([collision_object(cone), collision_object(ball)], {"cone": on_cone, "ball": 0.07 * unit}),
        "c.xml": (
            model,
            {"pill": 0.04 * unit + np.outer(np.sign(unit[:, 2]), (0, 0, 0.1)), "egg": unit * (0.03, 0.05, 0.1)},
        ),
    }
    for name, (content, points) in cases.items():
        caplog.clear()
        for shape in read_obstacles(saved(tmp_path / name, content)):
            assert isinstance(shape, Mesh)
            np.testing.assert_allclose(shape.pose, T, atol=1e-9)
            hull = trimesh.Trimesh(shape.vertices, shape.faces)
            assert hull.is_watertight and hull.is_convex
            normals, offsets = hull.face_normals, np.einsum("fi,fi->f", hull.face_normals, hull.triangles[:, 0])
            beyond = (points[shape.name] @ normals.T - offsets).max(axis=1)  # 0 on the surface, negative inside
            assert beyond.max() < 1e-9 and beyond.min() > -1.2e-3, shape.name
        assert (
            f"enclosed by a mesh, since an obstacle is a box, a cylinder or a mesh: '{next(iter(points))}'"
            in caplog.text
        )


MODEL = """
<mujoco>
  <compiler angle="degree" eulerseq="ZYX" autolimits="true"/>
  <default>
    <geom size="0.1 0.2 0.3"/>
    <default class="thin"><geom type="box" size="0.02 0.02 0.5" euler="90 0 0"/></default>
    <default class="visual"><geom contype="0" conaffinity="0"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="shelf" pos="1 0 0" euler="30 20 10" childclass="thin">
      <geom name="upright" pos="0 0 0.5"/>
      <geom pos="0 0.3 0.5" euler="0 0 45"/>
      <geom name="picture" class="visual" type="box" pos="0 0 2"/>
      <body name="board" pos="0 0 1"><geom name="deep" type="cylinder" fromto="0 0 0 0 0.4 0" size="0.03"/></body>
    </body>
    <body name="lamp" pos="0 1 1"><joint type="hinge" axis="0 0 1"/><geom type="box"/></body>
    <body name="cube" pos="0 2 1"><freejoint/><geom type="box"/></body>
  </worldbody>
</mujoco>
"""


def test_defaults_angles_and_nested_bodies_of_models_are_mujocos_business(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    upright, slanted, deep = read_obstacles(saved(tmp_path / "cell.mjcf", MODEL))
    T = pose((1.0, 0.0, 0.0))
    T[:3, :3] = Rotation.from_euler("zyx", [30, 20, 10], degrees=True).as_matrix()  # capitals: about fixed axes
    lying = pose((0.0, 0.0, 0.5))
    lying[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    tilted = pose((0.0, 0.3, 0.5))
    tilted[:3, :3] = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    assert upright.name == "upright" and slanted.name.startswith("shelf-") and deep.name == "deep"
    assert isinstance(upright, Box) and isinstance(slanted, Box) and isinstance(deep, Cylinder)
    np.testing.assert_allclose(upright.pose, T @ lying, atol=1e-9)
    np.testing.assert_allclose(slanted.pose, T @ tilted, atol=1e-9)
    np.testing.assert_allclose(upright.size, (0.04, 0.04, 1.0))
    np.testing.assert_allclose(deep.pose[:3, 3], (T @ pose((0.0, 0.2, 1.0)))[:3, 3], atol=1e-9)
    np.testing.assert_allclose(np.abs(deep.pose[:3, 2] @ T[:3, 1]), 1.0, atol=1e-9)
    np.testing.assert_allclose((deep.radius, deep.length), (0.03, 0.4), atol=1e-9)
    assert "left out, since it is an endless plane: 'floor'" in caplog.text
    assert "left out, since nothing collides with it: 'picture'" in caplog.text
    assert "left out, since it is a body that can move: 'lamp', 'cube'" in caplog.text


def test_objects_of_several_shapes_and_what_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    both = collision_object(BODIES[0])
    both["primitives"].append({"type": 3, "dimensions": [0.4, 0.03]})
    both["primitive_poses"].append(scene_texts.message_pose(BODIES[1].T))
    both |= {"planes": [{"coef": [0, 0, 1, 0]}], "plane_poses": [scene_texts.message_pose(np.eye(4))]}
    held = {"link_name": "tool0", "object": collision_object(BODIES[3])}
    gone = {**collision_object(BODIES[3]), "operation": 1}
    content = planning_scene([both, gone], robot_state={"attached_collision_objects": [held]})
    content["world"]["octomap"]["octomap"]["data"] = [1, 2, 3]
    crate, post = read_obstacles(saved(tmp_path / "scene.yaml", content))
    assert (crate.name, post.name) == ("crate one-1", "crate one-2")
    np.testing.assert_allclose(post.pose, BODIES[1].T, atol=1e-9)
    for said in ("an endless plane: 'crate one-3'", "attached to the robot: 'ball'", "a map of cells: 'octomap'"):
        assert f"left out, since it is {said}" in caplog.text
    text = scene_text((BODIES[0],)).replace("\n1\nbox", "\n2\nplane\n0 0 1 0\n0 0 0\n0 0 0 1\n0 0 0 0\nbox")
    (crate,) = read_obstacles(saved(tmp_path / "plane.scene", text))
    assert crate.name == "crate one-2" and "plane: 'crate one-1'" in caplog.text


def test_messages_as_ros_prints_them(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    bare = collision_object(BODIES[0])
    del bare["pose"]  # before MoveIt had poses of objects
    bare |= {
        "operation": "\0",
        "primitive_poses": [{"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"w": 0.0}}],
    }
    path = tmp_path / "echo.yaml"
    path.write_text("---\n".join(yaml.safe_dump(planning_scene([each])) for each in (bare, bare)), encoding="utf-8")
    (crate,) = read_obstacles(path)
    np.testing.assert_array_equal(crate.pose, pose((1.0, 2.0, 3.0)))
    assert "holds 2 messages; the first counts" in caplog.text
    words = {**collision_object(BODIES[0]), "primitives": [{"type": "box", "dimensions": [0.1, 0.2, 0.3]}]}
    (crate,) = read_obstacles(saved(tmp_path / "words.yaml", words))
    assert isinstance(crate, Box) and crate.size.tolist() == [0.1, 0.2, 0.3]


def test_yaml_may_refer_to_what_it_said_before(tmp_path: Path) -> None:
    first = yaml.safe_dump(collision_object(BODIES[0]), default_flow_style=True, width=10**6).strip()
    text = f"- &first {first}\n- {{<<: *first, id: second}}\n- {{<<: *first, id: third}}\n"
    found = read_obstacles(saved(tmp_path / "merged.yaml", text))
    assert [shape.name for shape in found] == ["crate one", "second", "third"]


def test_poses_may_be_in_the_frame_of_the_robots_root_link(tmp_path: Path) -> None:
    cell = load_workcell("nova2-w")
    root = str(cell.robot.model.frames[1].name)
    T_base = pose((0.3, 0.1, 0.5), (0.0, 0.0, 1.0))
    moved = replace(cell, arm=replace(cell.arm, T_world_base=T_base))
    message = saved(tmp_path / "scene.yaml", [collision_object(BODIES[0], root)])
    text = saved(tmp_path / "a.scene", scene_text(BODIES[:1]))
    model = saved(tmp_path / "a.xml", mjcf(BODIES[:1]))
    for read in (
        read_obstacles(message, moved),
        read_obstacles(text, moved, frame=root),
        read_obstacles(model, moved, frame=root),
    ):
        np.testing.assert_allclose(read[0].pose, T_base @ BODIES[0].T, atol=1e-9)
    np.testing.assert_allclose(read_obstacles(text, moved)[0].pose, BODIES[0].T, atol=1e-9)
    with pytest.raises(WorkcellError, match=f"in the frame '{root}', and known are 'world'; transform it first"):
        read_obstacles(message)
    for path, frame in ((text, "camera"), (message, root), (tmp_path / "a.toml", "world")):
        with pytest.raises(OptionError, match=f"frame '{frame}' is not known or not needed"):
            read_obstacles(path, moved, frame=frame)


def test_a_root_link_called_world_moves_only_what_names_it(tmp_path: Path) -> None:
    urdf = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8").replace('"base_link"', '"world"')
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8").replace('"nova2"', '"arm.urdf"')
    saved(tmp_path / "arm.urdf", urdf)
    cell = load_workcell(saved(tmp_path / "cell.toml", text))
    assert cell.robot.model.frames[1].name == "world"
    T_base = pose((0.3, 0.1, 0.5), (0.0, 0.0, 1.0))
    moved = replace(cell, arm=replace(cell.arm, T_world_base=T_base))
    for path in (saved(tmp_path / "a.scene", scene_text(BODIES[:1])), saved(tmp_path / "a.xml", mjcf(BODIES[:1]))):
        for frame in (None, "world"):
            np.testing.assert_allclose(read_obstacles(path, moved, frame=frame)[0].pose, BODIES[0].T, atol=1e-9)
    for name in ("world", ""):
        message = saved(tmp_path / "a.yaml", [collision_object(BODIES[0], name)])
        np.testing.assert_allclose(read_obstacles(message, moved)[0].pose, T_base @ BODIES[0].T, atol=1e-9)


def _changed(body: Body = BODIES[0], **changes: Any) -> list[dict[str, Any]]:
    return [{**collision_object(body), **changes}]


BROKEN = {
    "none.scene": (None, "cannot be read; give a .scene file"),
    "none.yaml": (None, "cannot read"),
    "none.xml": (None, "cannot be read"),
    "cut.scene": (scene_text()[:-3], "is cut short; it ends with a line '.'"),
    "text.scene": ("hello\nworld\n.\n", "not a .scene file of MoveIt's"),
    "number.scene": (scene_text().replace("0.2 0.1 0.3", "0.2 wide 0.3"), "object 'crate one' is not complete"),
    "few.scene": (scene_text().replace("0.2 0.1 0.3", "0.2 0.3"), "object 'crate one' is not complete"),
    "more.scene": (scene_text().replace("\n1\nbox", "\n2\nbox", 1), "object 'crate one'"),
    "less.scene": (scene_text().replace("\n1\nbox", "\n0\nbox", 1), "object 'crate one' is not complete"),
    "nan.scene": (scene_text().replace("0.2 0.1 0.3", "0.2 nan 0.3"), "is a box of dimensions [0.2, nan, 0.3]"),
    "far.scene": (scene_text().replace("\n0.4 0.1 0.15", "\n40 10 150"), "'crate one' is 150 m away; give metres"),
    "count.scene": (scene_text().replace("mesh\n", f"mesh\n{10**30}"), "object 'bracket' is not complete"),
    "flat.scene": (scene_text().replace("0.2 0.1 0.3", "0.2 0.0 0.3"), "is a box of dimensions [0.2, 0.0, 0.3]"),
    "kind.scene": (scene_text().replace("\nbox", "\nprism"), "a shape of kind 'prism'; known: box, sphere"),
    "huge.scene": (scene_text().replace("mesh\n", "mesh\n9999999999"), "object 'bracket' is not complete"),
    "turn.scene": (scene_text(BODIES[3:]).replace("0.0 0.0 0.0 1.0", "0.0 0.0 0.0 2.0"), "quaternion of length 2, not"),
    "empty.scene": ("(noname)+\n.\n", "has no obstacles; omit it"),
    "empty.yaml": ("", "is empty; give a planning scene"),
    "cut.yaml": ("world: {collision_objects: [", "not valid YAML"),
    "other.yaml": ({"name": "scene", "worlds": {}}, "has no 'world' with 'collision_objects'"),
    "list.yaml": ([1, 2], "has no 'world' with 'collision_objects'"),
    "nothing.yaml": ([], "has no obstacles; omit it"),
    "names.yaml": (_changed(primitives=[], primitive_poses=[]), "object 'crate one' has no shapes"),
    "type.yaml": (_changed(primitives=[{"type": 9, "dimensions": [1, 1, 1]}]), "a shape of kind '9'"),
    "size.yaml": (_changed(primitives=[{"type": 1, "dimensions": [1, 1]}]), "is a box of dimensions [1.0, 1.0]"),
    "poses.yaml": (_changed(primitive_poses=2 * [scene_texts.message_pose(np.eye(4))]), "has 1 primitives and 2 poses"),
    "short.yaml": (_changed(primitives=[{"type": 1, "dimensions": [1, 1, "..."]}]), "use --full-length"),
    "pose.yaml": (_changed(pose=[0, 0, 0]), "object 'crate one' is not a CollisionObject"),
    "twice.yaml": ("{id: c, header: {}, pose: {}, pose: {}}", "has the key 'pose' twice in one place; keep the one"),
    "key.yaml": (_changed(primitive_pose=[]), "object 'crate one' has the unknown key 'primitive_pose'"),
    "axis.yaml": (_changed(pose={"position": {"x": 1, "w": 2}}), "has the unknown key 'w'"),
    "diff.yaml": ({**planning_scene(_changed()), "is_diff": True}, "give a whole scene, not a difference"),
    "move.yaml": (_changed(operation=3), "is only moved; give a whole scene"),
    "frame.yaml": ([collision_object(BODIES[0], "camera")], "is in the frame 'camera', and known are 'world'"),
    "urdf.xml": ('<robot name="arm"><link name="base"/></robot>', "it has no <mujoco>; give an MJCF file"),
    "wrong.xml": ("<mujoco><worldbody><geom typ='box'/></worldbody></mujoco>", "unrecognized attribute: 'typ'"),
    "cut.xml": ("<mujoco><worldbody>", "cannot be read"),
    "empty.xml": ("<mujoco><worldbody><geom type='plane' size='1 1 1'/></worldbody></mujoco>", "has no obstacles"),
    "nan.xml": ("<mujoco><worldbody><geom type='box' size='1 1 1' pos='nan 0 0'/></worldbody></mujoco>", "holds NaN"),
    "mesh.xml": ("<mujoco><asset><mesh name='m' file='m.obj'/></asset></mujoco>", "m.obj"),
    "field.xml": (
        "<mujoco><asset><hfield name='h' nrow='2' ncol='2' size='1 1 1 1'/></asset><worldbody>"
        "<geom name='hill' type='hfield' hfield='h'/></worldbody></mujoco>",
        "geom 'hill' is of type hfield, which no obstacle can be",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(BROKEN))
def test_broken_files_are_refused_with_one_sentence(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    content, said = BROKEN[name]
    caplog.set_level(logging.ERROR)
    if content is not None:
        saved(tmp_path / name, content)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RegraspError) as caught:
        read_obstacles(tmp_path / name)
    assert said in str(caught.value) and name in str(caught.value) and "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ([] if content is None else [name])  # nothing was left there


def test_other_files_are_read_as_toml(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(
        '[[obstacles]]\ntype = "box"\nname = "crate"\nsize = [0.1, 0.2, 0.3]\nposition = [1, 2, 3]\n', encoding="utf-8"
    )
    assert [shape.name for shape in read_obstacles(tmp_path / "a.toml")] == ["crate"]


def test_without_mujoco_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path / "a.xml", mjcf(BODIES[:1]))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(WorkcellError, match=r"needs the package mujoco; install regrasp-opt\[formats\]"):
        read_obstacles(path)
