"""Mesh files that would make a library read memory that is not its own are refused, whoever they are for."""

import numpy as np
import pytest
import trimesh
from oracles.files import DATA

from regrasp_opt import load_object, load_workcell
from regrasp_opt.errors import MeshError, WorkcellError
from regrasp_opt.geometry.mesh_files import read_triangles
from regrasp_opt.robots import load_robot

ARM = """<robot name="arm"><link name="base"/><link name="tool0"><collision><geometry><mesh filename="part.ply"/>
</geometry></collision></link><joint name="a" type="revolute"><parent link="base"/><child link="tool0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"""
OBSTACLE = '\n[[obstacles]]\ntype = "mesh"\nname = "part"\nposition = [0.5, 0.5, 0.1]\nfile = "part.ply"\n'


def ply(vertices, faces):
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, v)) for v in vertices] + [f"3 {a} {b} {c}" for a, b, c in faces]
    return "\n".join(lines) + "\n"


BOX = trimesh.creation.box((0.04, 0.05, 0.1))
CORNERS, TRIANGLES = BOX.vertices.tolist(), BOX.faces.tolist()
BROKEN = {
    "an index too large": (ply(CORNERS, [*TRIANGLES[1:], [0, 1, 268]]), "whose vertices do not exist"),
    "a negative index": (ply(CORNERS, [*TRIANGLES[1:], [0, 1, -2]]), "whose vertices do not exist"),
    "a vertex that is not a number": (ply([["nan", 0, 0], *CORNERS[1:]], TRIANGLES), "NaN or infinite"),
    "a vertex far away": (ply([[1e30, 0, 0], *CORNERS[1:]], TRIANGLES), "more than 1e\\+09 units from the origin"),
    "no triangle": (ply(CORNERS, []), "no triangles|corrupt"),
    "a property of no type": (ply(CORNERS, TRIANGLES).replace("list uchar int", "lst uchar int"), "corrupt"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_meshes_are_refused_for_objects_obstacles_and_links(name, tmp_path, caplog, capfd):
    content, said = BROKEN[name]
    (tmp_path / "part.ply").write_text(content, encoding="utf-8")
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    cell = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8") + OBSTACLE
    (tmp_path / "cell.toml").write_text(cell, encoding="utf-8")
    with pytest.raises(MeshError, match=said):
        load_object(tmp_path / "part.ply")
    with pytest.raises(WorkcellError, match=said):
        load_workcell(tmp_path / "cell.toml")
    with pytest.raises(WorkcellError, match=said):
        load_robot(tmp_path / "arm.urdf")
    assert "Traceback" not in caplog.text + capfd.readouterr().err


def test_sound_meshes_are_read_for_all_three(tmp_path):
    (tmp_path / "part.ply").write_text(ply(CORNERS, TRIANGLES), encoding="utf-8")
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    cell = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8") + OBSTACLE
    (tmp_path / "cell.toml").write_text(cell, encoding="utf-8")
    vertices, faces = read_triangles(tmp_path / "part.ply")
    np.testing.assert_allclose(vertices, CORNERS, atol=1e-6)
    np.testing.assert_array_equal(faces, TRIANGLES)
    assert load_object(tmp_path / "part.ply").mesh.volume == pytest.approx(0.0002)
    assert load_workcell(tmp_path / "cell.toml").obstacles[0].name == "part"
    assert load_robot(tmp_path / "arm.urdf").dof == 1
    (tmp_path / "cell.toml").write_text(f"{cell}scale = 1e6\n", encoding="utf-8")
    with pytest.raises(WorkcellError, match="write scale = 1"):
        load_workcell(tmp_path / "cell.toml")
