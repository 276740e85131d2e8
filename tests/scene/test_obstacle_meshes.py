"""Meshes of obstacles: their size in metres, and whether they have an inside."""

from importlib.resources import files

import numpy as np
import pytest
import trimesh

from regrasp_opt.errors import WorkcellError
from regrasp_opt.scene import load_workcell

CELL = (files("regrasp_opt") / "data" / "workcells" / "nova2-w.toml").read_text("utf-8")
OBSTACLE = '\n[[obstacles]]\ntype = "mesh"\nname = "part"\nposition = [0.5, 0.5, 0.1]\nfile = "part.stl"\n'
BOX = trimesh.creation.box((0.04, 0.05, 0.1))


def load(tmp_path, mesh, more=""):
    mesh.export(tmp_path / "part.stl")
    (tmp_path / "cell.toml").write_text(CELL + OBSTACLE + more, encoding="utf-8")
    return load_workcell(tmp_path / "cell.toml")


@pytest.mark.parametrize(
    ("size", "offset", "given", "said"),
    [
        (1000, 0, None, "is 100 m long and looks like millimetres; write scale = 0.001"),
        (1000, 0, 2, "is 200 m long and looks like millimetres; write scale = 0.002"),
        (1e6, 0, None, "micrometres; write scale = 1e-06"),
        (50, 500, None, "reaches 502.5 m from its origin and looks like millimetres; write scale = 0.001"),
        (0.001, 0, None, "is only 0.0001 m long and was perhaps scaled twice; write scale = 1000"),
        (1, 0, 0.001, "is only 0.0001 m long and was perhaps scaled twice; write scale = 1"),
    ],
)
def test_a_mesh_in_another_unit_is_refused_with_the_scale_to_write(tmp_path, size, offset, given, said):
    mesh = BOX.copy()
    mesh.apply_scale(size)
    mesh.apply_translation([0, 0, offset])
    scale = "" if given is None else f"scale = {given}\n"
    with pytest.raises(WorkcellError, match="of obstacle 'part'") as caught:
        load(tmp_path, mesh, scale)
    assert str(caught.value).endswith(said)
    right = said.rpartition("scale = ")[2]
    assert np.ptp(load(tmp_path, mesh, f"scale = {right}\n").obstacles[0].vertices, axis=0).max() < 0.3


def test_a_large_hall_and_a_small_screw_stay_as_they_are(tmp_path, caplog):
    hall = trimesh.util.concatenate([trimesh.creation.box((19, 19, 0.1))])
    hall.apply_translation([0, 0, -3])
    assert load(tmp_path, hall).obstacles[0].vertices[:, 0].max() == pytest.approx(9.5)
    screw = trimesh.creation.cylinder(0.0005, 0.002)
    assert load(tmp_path, screw).obstacles[0].vertices[:, 2].max() == pytest.approx(0.001)
    wide = CELL + '\n[[obstacles]]\ntype = "box"\nname = "floor"\nposition = [0, 0, -1]\nsize = [500, 500, 0.1]\n'
    (tmp_path / "cell.toml").write_text(wide, encoding="utf-8")
    load_workcell(tmp_path / "cell.toml")
    assert not caplog.records


def test_a_mesh_that_is_not_closed_is_said_in_one_line(tmp_path, caplog):
    load(tmp_path, trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False))
    (record,) = caplog.records
    assert "obstacle 'part' is not closed" in record.getMessage() and "\n" not in record.getMessage()


def test_a_robot_inside_a_closed_mesh_is_said_at_home(tmp_path):
    with pytest.raises(WorkcellError, match="collides with 'part'"):
        load(tmp_path, trimesh.creation.box((8, 8, 8)))
    inner = trimesh.creation.box((7, 7, 7))
    inner.invert()
    load(tmp_path, trimesh.util.concatenate([trimesh.creation.box((8, 8, 8)), inner]))
