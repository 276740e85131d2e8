"""Sizes of the bodies of links, units of their meshes, and links with an inside."""

from functools import partial

import numpy as np
import pytest
import trimesh
from arms import arm_urdf
from collisions import colliding_links
from dae_files import collada, triangles

from regrasp_opt.errors import WorkcellError
from regrasp_opt.geometry.shapes import mesh_faces
from regrasp_opt.geometry.solids import Solid
from regrasp_opt.robots import load_robot

TURN = (-3.1, 3.1)
ARM = arm_urdf(
    [("revolute", "0 0 0.3", "0 0 0", "0 1 0", TURN)] + [("revolute", "0 0 0.4", "0 0 0", "0 1 0", TURN)] * 2
)
BOX = trimesh.creation.box((0.1, 0.1, 0.35))


def with_body(text, link, shape):
    body = f"<link name='{link}'><collision><geometry>{shape}</geometry></collision></link>"
    return text.replace(f"<link name='{link}'/>", body).replace(f"<link name='{link}'></link>", body)


def load(tmp_path, shape, link="link2"):
    (tmp_path / "arm.urdf").write_text(with_body(ARM, link, shape), encoding="utf-8")
    return load_robot(tmp_path / "arm.urdf")


def write_mesh(tmp_path, size=1.0, mesh=BOX):
    mesh = mesh.copy()
    mesh.apply_scale(size)
    mesh.export(tmp_path / "part.stl")


def size(robot):
    (item,) = robot.collision.geometryObjects
    item.geometry.computeLocalAABB()
    return np.array(item.geometry.aabb_local.max_) - np.array(item.geometry.aabb_local.min_)


@pytest.mark.parametrize(
    ("size_given", "scale", "right"),
    [(1000, "", "0.001 0.001 0.001"), (10, 'scale="1 -1 1"', "0.001 -0.001 0.001"), (0.001, "", "1000 1000 1000")],
)
def test_a_link_mesh_in_another_unit_is_refused_with_the_scale_to_write(tmp_path, size_given, scale, right):
    write_mesh(tmp_path, size_given)
    with pytest.raises(WorkcellError) as caught:
        load(tmp_path, f'<mesh filename="part.stl" {scale}/>')
    text = str(caught.value)
    assert "link 'link2', <collision> number 1" in text and f'write scale="{right}"' in text
    load(tmp_path, f'<mesh filename="part.stl" scale="{right}"/>')


def test_sizes_of_primitives_are_in_metres_too(tmp_path):
    with pytest.raises(WorkcellError, match=r"link 'link2', <collision> number 1 is 300 m long"):
        load(tmp_path, '<cylinder radius="3" length="300"/>')
    load(tmp_path, '<sphere radius="0.0001"/>')  # a stand-in that many files have
    load(tmp_path, '<box size="30 30 0.1"/>', link="link0")  # the floor


@pytest.mark.parametrize(("unit", "meter"), [("mm", 0.001), ("inch", 0.0254), ("m", 1.0)])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_the_unit_of_a_dae_file_is_honoured(tmp_path, unit, meter, scale):
    part = (BOX.vertices / meter, partial(triangles, BOX.faces.tolist()), "")
    (tmp_path / "part.dae").write_text(
        collada([part, part], f'<unit name="{unit}" meter="{meter}"/>'), encoding="utf-8"
    )
    robot = load(tmp_path, f'<mesh filename="part.dae" scale="{scale} {scale} {scale}"/>')
    np.testing.assert_allclose(size(robot), scale * BOX.extents, atol=1e-9)


@pytest.mark.parametrize("scale", ["1 1 1", "-1 1 1", "-1 -1 -1"])
def test_a_mirrored_mesh_is_not_inside_out(tmp_path, scale):
    write_mesh(tmp_path)
    (item,) = load(tmp_path, f'<mesh filename="part.stl" scale="{scale}"/>').collision.geometryObjects
    solid = Solid(item.geometry)
    corners = np.array(item.geometry.vertices())[mesh_faces(item.geometry)]
    assert np.linalg.det(corners).sum() / 6 == pytest.approx(BOX.volume)
    assert solid.holds(np.zeros((1, 3))) and not solid.holds(np.full((1, 3), 0.3))


def test_link_meshes_that_are_not_closed_are_said_in_one_line(tmp_path, caplog):
    write_mesh(tmp_path, mesh=trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False))
    load(tmp_path, '<mesh filename="part.stl"/>')
    said = [record.getMessage() for record in caplog.records if "not closed" in record.getMessage()]
    assert len(said) == 1 and "link2" in said[0]


def test_a_link_inside_another_collides_with_it(tmp_path):
    write_mesh(tmp_path, mesh=trimesh.creation.box((1.9, 1.9, 1.9)))
    both = with_body(with_body(ARM, "link0", '<mesh filename="part.stl"/>'), "link3", '<box size="0.1 0.1 0.1"/>')
    (tmp_path / "both.urdf").write_text(both, encoding="utf-8")
    robot = load_robot(tmp_path / "both.urdf")
    assert colliding_links(robot, [0.0, 2.5, 0.0]) == ("link0", "link3")  # wholly inside
    assert colliding_links(robot, [0.0, 0.0, 0.0]) is None  # above
