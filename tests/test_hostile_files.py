"""Files from strangers: names that are not paths, nesting without end, and files that they name elsewhere."""

import json
import logging
import struct
import subprocess
import sys

import pytest
import trimesh
from fuzz.targets import case
from oracles.files import DATA

from regrasp_opt import load_object, load_workcell
from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.energy.storage import load_energy
from regrasp_opt.errors import MeshError, ModelError, PoseError, WorkcellError
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.pose_text import parse_pose
from regrasp_opt.robots import load_robot

CELL = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
MESH = '\n[[obstacles]]\ntype = "mesh"\nname = "part"\nposition = [0.6, 0.5, 0.1]\nfile = "{}"\n'
ARM = """<robot name="arm"><link name="base"/><link name="tool0"><collision><geometry><mesh filename="{}"/></geometry>
</collision></link><joint name="a" type="revolute"><parent link="base"/><child link="tool0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"""
LONG, NUL = "x" * 5000, "a\\u0000b"


def refused(load, path, content, said, error=WorkcellError):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(error, match=said) as info:
        load(path)
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("name", [LONG, NUL], ids=["long", "null"])
def test_names_that_no_file_can_have_are_refused(name, tmp_path):
    path, robot = tmp_path / "file.toml", tmp_path / "arm.urdf"
    refused(load_workcell, path, CELL + MESH.format(name + ".stl"), "of obstacle 'part' does not exist")
    refused(load_workcell, path, CELL.replace('"nova2"', f'"{name}.urdf"'), "robot file .* cannot be read")
    refused(load_workcell, path, CELL.replace('"w"', f'"{name}.toml"'), "end-effector file .* cannot be read")
    plain = name.replace("\\u0000", "")
    refused(load_robot, robot, ARM.format(plain + ".stl"), "is not found")
    for load, error in ((load_object, MeshError), (load_workcell, WorkcellError), (load_robot, WorkcellError)):
        suffix = {load_object: ".stl", load_workcell: ".toml", load_robot: ".urdf"}[load]
        with pytest.raises(error, match=r"does not exist|cannot be read"):
            load(name.encode().decode("unicode_escape") + suffix)
    with pytest.raises(PoseError):
        parse_pose(LONG, "start", RegraspProblem.load("bottle", "nova2-w"))


@pytest.mark.parametrize("value", ["[" * 5000, "9" * 5000], ids=["nested", "digits"])
def test_values_without_end_are_refused(value, tmp_path):
    path = tmp_path / "file.toml"
    refused(load_workcell, path, f"{CELL}\na = {value}", "is not valid TOML")
    refused(load_end_effector, path, f"a = {value}", "is not valid TOML")


def test_xml_of_another_coding_or_nested_too_deep_is_refused(tmp_path):
    path, inner = tmp_path / "arm.urdf", "<a>" * 20_000 + "</a>" * 20_000
    refused(load_robot, path, '<?xml version="1.0" encoding="utf-32"?>' + ARM, "is not valid XML")
    refused(load_robot, path, '<?xml version="1.0" encoding="none"?>' + ARM, "is not valid XML")
    arm = ARM.replace('<collision><geometry><mesh filename="{}"/></geometry>\n</collision>', "")
    assert "mesh" not in arm
    refused(load_robot, path, arm.replace("</robot>", f"{inner}</robot>"), "nested too deeply")
    refused(load_robot, path, ARM.format("package://"), "mesh 'package://' is not found")


def test_a_model_whose_header_is_nested_too_deep_is_refused(tmp_path):
    header = json.dumps({"__metadata__": {"regrasp_opt": "[" * 100_000}}).encode()
    refused(load_energy, tmp_path / "a.safetensors", struct.pack("<Q", len(header)) + header, "corrupt", ModelError)


def test_a_model_with_a_number_that_is_no_float_is_refused(tmp_path):
    whole = (DATA / "models" / "bottle-nova2-w" / "energy.safetensors").read_bytes()
    (size,) = struct.unpack("<Q", whole[:8])
    header = json.loads(whole[8 : 8 + size])
    inner = json.loads(header["__metadata__"]["regrasp_opt"])
    header["__metadata__"]["regrasp_opt"] = json.dumps({**inner, "threshold": 10**400})
    text = json.dumps(header).encode()
    content = struct.pack("<Q", len(text)) + text + whole[8 + size :]
    refused(load_energy, tmp_path / "a.safetensors", content, "lacks a field", ModelError)


@pytest.mark.parametrize("number", [220, 2865])
def test_meshes_that_two_readers_take_differently_are_read_once(number, tmp_path):
    """Damaged files that we read well, and that end the process in the reader of Pinocchio."""
    suffix, content = case("mesh of a link", 0, number, tmp_path)
    (tmp_path / f"part{suffix}").write_bytes(content)
    (tmp_path / "arm.urdf").write_text(ARM.format(f"part{suffix}"), encoding="utf-8")
    script = "import sys; from regrasp_opt.robots import load_robot; print(load_robot(sys.argv[1]).dof)"
    done = subprocess.run(
        [sys.executable, "-c", script, tmp_path / "arm.urdf"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr


@pytest.fixture
def mesh(tmp_path):
    """Return a mesh in a folder beside that of the file which names it."""
    (tmp_path / "own").mkdir()
    (tmp_path / "other").mkdir()
    path = tmp_path / "other" / "part.stl"
    trimesh.creation.box((0.1, 0.1, 0.1)).export(path)
    return path


def warnings_of(load, path, content, caplog, **options):
    path.write_text(content, encoding="utf-8")
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        load(path, **options)
    return [record.getMessage() for record in caplog.records]


def test_a_workcell_that_names_files_elsewhere_says_so_once(mesh, tmp_path, caplog):
    path, robot = tmp_path / "own" / "cell.toml", tmp_path / "other" / "arm.urdf"
    [said] = warnings_of(load_workcell, path, CELL + MESH.format("../other/part.stl"), caplog)
    assert said.startswith(f"{path} refers to '{mesh}' outside its folder")
    [said] = warnings_of(load_workcell, path, CELL + MESH.format(mesh), caplog)
    assert f"'{mesh}'" in said
    robot.write_bytes((DATA / "robots" / "nova2" / "nova2.urdf").read_bytes())
    home = "home = [-1.913, 0, 1.4, 0.2, -1.57, -0.34]\npackage_dirs = ['..']"
    both = CELL.replace('model = "nova2"', f'model = "../other/arm.urdf"\n{home}') + MESH.format("../other/part.stl")
    [said] = warnings_of(load_workcell, path, both, caplog)
    assert f"refers to '{robot}' and 2 more outside its folder" in said


def test_a_robot_that_names_meshes_elsewhere_says_so_unless_their_folder_is_given(mesh, tmp_path, caplog):
    path, content = tmp_path / "own" / "arm.urdf", ARM.format("../other/part.stl")
    [said] = warnings_of(load_robot, path, content, caplog)
    assert said.startswith(f"{path} refers to '{mesh}' outside its folder")
    assert warnings_of(load_robot, path, content, caplog, package_dirs=[mesh.parent]) == []
    assert len(warnings_of(load_robot, path, ARM.format("package://other/part.stl"), caplog)) == 1
    (tmp_path / "package.xml").write_text("<package/>", encoding="utf-8")
    assert warnings_of(load_robot, path, content, caplog) == []


def test_a_link_out_of_the_folder_counts_as_elsewhere(mesh, tmp_path, caplog):
    (tmp_path / "own" / "inside.stl").symlink_to(mesh)
    [said] = warnings_of(load_workcell, tmp_path / "own" / "cell.toml", CELL + MESH.format("inside.stl"), caplog)
    assert f"'{mesh}'" in said


def test_files_in_the_own_folder_need_no_word(mesh, tmp_path, caplog):
    own = tmp_path / "other" / "cell.toml"
    assert warnings_of(load_workcell, own, CELL + MESH.format("part.stl"), caplog) == []
    assert warnings_of(load_workcell, own, CELL + MESH.format("./../other/part.stl"), caplog) == []
    assert warnings_of(load_robot, tmp_path / "other" / "arm.urdf", ARM.format("part.stl"), caplog) == []
