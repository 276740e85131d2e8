"""Workcells: the built-in ones, files of one's own, what is refused and with which words, fingerprints."""

import pickle
from importlib.resources import files

import numpy as np
import pytest
import trimesh

from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh
from regrasp_opt.scene import FURTHER_WORKCELL_NAMES, WORKCELL_NAMES, load_workcell

DATA = files("regrasp_opt") / "data"
BUILT_IN = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
BOX = """
[[obstacles]]
type = "box"
name = "crate"
position = [0.5, 0.8, 0.1]
size = [0.2, 0.3, 0.2]
"""
CYLINDER = """
[[obstacles]]
type = "cylinder"
name = "post"
position = [-0.5, 0.8, 0.2]
rpy = [0.0, 1.5707963267948966, 0.0]
radius = 0.03
length = 0.4
"""
MESH = """
[[obstacles]]
type = "mesh"
name = "part"
position = [0.6, 0.0, 0.1]
file = "meshes/part.stl"
scale = 0.001
"""


@pytest.fixture
def write(tmp_path):
    def write_workcell(text, name="mine.toml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write_workcell


@pytest.fixture
def part(tmp_path):
    (tmp_path / "meshes").mkdir()
    path = tmp_path / "meshes" / "part.stl"
    trimesh.creation.box((100, 50, 80)).export(path)
    return path


def changed(old, new, text=BUILT_IN):
    assert text.count(old) == 1, f"'{old}' stands {text.count(old)} times in the file"
    return text.replace(old, new)


def refusal(path):
    with pytest.raises(WorkcellError) as info:
        load_workcell(path)
    message = str(info.value)
    assert "\n" not in message
    assert str(path) in message
    return message


@pytest.mark.parametrize("name", WORKCELL_NAMES)
def test_built_in_workcells_load(name):
    cell = load_workcell(name)
    assert (cell.name, cell.source, cell.robot.name) == (name, "built-in", "nova2")
    assert cell.end_effector.name == name.removeprefix("nova2-")
    assert cell.bounds.x == (-0.45, 0.45)
    assert cell.bounds.y == (0.1, 0.6)
    assert (cell.clearance.arm, cell.clearance.gripper) == (0.005, 0.003)
    np.testing.assert_array_equal(cell.T_world_base, np.eye(4))


def test_built_in_names_are_the_files_there_are():
    names = (*WORKCELL_NAMES, *FURTHER_WORKCELL_NAMES)
    assert sorted(names) == sorted(p.name.removesuffix(".toml") for p in (DATA / "workcells").iterdir())


def test_the_top_of_the_table_is_at_its_height(write):
    table = load_workcell(write(changed("height = 0.0", "height = -0.1"))).table.shape
    assert table.pose[2, 3] + table.size[2] / 2 == pytest.approx(-0.1)
    np.testing.assert_allclose(table.size, (1.4, 1.2, 0.05))
    np.testing.assert_allclose(table.pose[:2, 3], (0, 0.35))


def test_the_base_stands_where_the_file_says(write):
    text = changed("position = [0.0, 0.0, 0.0]", "position = [0.1, 0.0, 0.2]")
    cell = load_workcell(write(changed("rpy = [0.0, 0.0, 0.0]", "rpy = [0.0, 0.0, 0.5]", text)))
    c, s = np.cos(0.5), np.sin(0.5)
    np.testing.assert_allclose(
        cell.T_world_base, [[c, -s, 0, 0.1], [s, c, 0, 0], [0, 0, 1, 0.2], [0, 0, 0, 1]], atol=1e-15
    )
    np.testing.assert_allclose(cell.arm.T_base_world @ cell.T_world_base, np.eye(4), atol=1e-15)


def test_obstacles_of_every_type(write, part, monkeypatch):
    monkeypatch.chdir("/")
    box, cylinder, mesh = load_workcell(write(BUILT_IN + BOX + CYLINDER + MESH)).obstacles
    assert (type(box), type(cylinder), type(mesh)) == (Box, Cylinder, Mesh)
    assert (box.name, cylinder.radius, cylinder.length) == ("crate", 0.03, 0.4)
    np.testing.assert_allclose(box.size, (0.2, 0.3, 0.2))
    np.testing.assert_allclose(cylinder.pose[:3, 2], (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), (0.1, 0.05, 0.08))
    np.testing.assert_allclose(mesh.pose[:3, 3], (0.6, 0.0, 0.1))


def test_robot_and_end_effector_files_are_relative_to_the_workcell(write, tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    (tmp_path / "arm.urdf").write_bytes((DATA / "robots" / "nova2" / "nova2.urdf").read_bytes())
    (tmp_path / "tool.toml").write_bytes((DATA / "end_effectors" / "r85.toml").read_bytes())
    text = changed('model = "nova2"', 'model = "arm.urdf"\nhome = [-1.913, 0, 1.4, 0.2, -1.57, -0.34]')
    cell = load_workcell(write(changed('model = "w"', 'model = "tool.toml"', text)))
    assert cell.fingerprint() == load_workcell("nova2-r85").fingerprint()


def test_the_end_effector_can_be_replaced():
    cell = load_workcell("nova2-w", end_effector="r85")
    assert (cell.name, cell.end_effector_override) == ("nova2-w", "r85")
    assert cell.fingerprint() == load_workcell("nova2-r85").fingerprint()
    same = load_workcell("nova2-w", end_effector="w")
    assert same.name == "nova2-w"
    with pytest.raises(UnknownNameError):
        load_workcell("nova2-w", end_effector="r84")


def test_workcells_travel_between_processes():
    cell = load_workcell("nova2-s1")
    assert pickle.loads(pickle.dumps(cell)).fingerprint() == cell.fingerprint()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("position = [0.0, 0.0, 0.0]", "position = [0.0, 0.0, 0.01]"),
        ("rpy = [0.0, 0.0, 0.0]", "rpy = [0.0, 0.0, 0.01]"),
        ('model = "w"', 'model = "r85"'),
        ("height = 0.0", "height = -0.01"),
        ("thickness = 0.05", "thickness = 0.06"),
        ("size = [1.4, 1.2]", "size = [1.4, 1.3]"),
        ("x = [-0.45, 0.45]", "x = [-0.45, 0.44]"),
        ("arm = 0.005", "arm = 0.006"),
        ("gripper = 0.003", "gripper = 0.004"),
        ("self_collision = 0.0", "self_collision = 0.001"),
        ('model = "nova2"', 'model = "nova2"\nignore_collisions = [["link2", "link5"]]'),
        ("schema = 1", "schema = 1\n#\n"),
    ],
)
def test_fingerprint_follows_geometry_alone(write, old, new):
    same = load_workcell("nova2-w").fingerprint() == load_workcell(write(changed(old, new))).fingerprint()
    assert same == old.startswith("schema")


def test_fingerprint_follows_obstacles_but_no_names_and_no_home(write, part):
    plain = load_workcell(write(BUILT_IN + BOX + MESH)).fingerprint()
    assert plain != load_workcell("nova2-w").fingerprint()
    assert plain != load_workcell(write(BUILT_IN + BOX.replace("0.2, 0.3", "0.2, 0.2") + MESH)).fingerprint()
    renamed = changed("schema = 1", 'schema = 1\nname = "other"') + BOX.replace("crate", "bin") + MESH
    assert load_workcell(write(renamed, "other.toml")).fingerprint() == plain
    home = changed('model = "nova2"', 'model = "nova2"\nhome = [-1.9, 0, 1.4, 0.2, -1.57, -0.34]')
    assert load_workcell(write(home + BOX + MESH)).fingerprint() == plain
    trimesh.creation.box((100, 50, 81)).export(part)
    assert load_workcell(write(BUILT_IN + BOX + MESH)).fingerprint() != plain


def test_unknown_workcells_list_the_known_ones():
    with pytest.raises(UnknownNameError) as info:
        load_workcell("nova-r85")
    assert info.value.alternatives[0] == "nova2-r85"
    assert set(info.value.alternatives) == {*WORKCELL_NAMES, *FURTHER_WORKCELL_NAMES}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("arm = 0.005", "arms = 0.005", "unknown key 'clearance.arms'; allowed: arm, "),
        ("[workspace]", "[workspac]", "unknown key 'workspac'; allowed: workspace, "),
        ("height = 0.0", "heigth = 0.0", "unknown key 'table.heigth'; allowed: height, "),
        ("schema = 1", "", "key 'schema' is missing"),
        ("schema = 1", "schema = 3", "key 'schema' is 3; this version reads schemas 1 and 2"),
        ("size = [1.4, 1.2]", "", "key 'table.size' is missing"),
        ("size = [1.4, 1.2]", "size = [1.4]", "key 'table.size.1' is missing"),
        ("size = [1.4, 1.2]", "size = [1.4, -1.2]", "key 'table.size.1': should be greater than 0, not -1.2"),
        ("size = [1.4, 1.2]", "size = 'big'", "key 'table.size': should be a valid tuple, not 'big'"),
        ("height = 0.0", "height = 'low'", "key 'table.height': should be a valid number"),
        ("height = 0.0", "height = nan", "key 'table.height': should be a finite number, not nan"),
        ("arm = 0.005", "arm = -0.1", "key 'clearance.arm': should be greater than or equal to 0, not -0.1"),
        (
            "x = [-0.45, 0.45]",
            "x = [0.45, -0.45]",
            "key 'workspace.x': should be [low, high] with low < high",
        ),
        ("x = [-0.45, 0.45]", "x = [-0.45, 0.9]", "key 'workspace.x': -0.45 to 0.9 leaves the table"),
        ("x = [-0.45, 0.45]", "x = [-450, 450]", "key 'workspace.x': -450 to 450 is wider than 10 m"),
        ("rpy = [0.0, 0.0, 0.0]", "rpy = [0.0, 0.0]", "key 'robot.rpy.2' is missing"),
        ('model = "nova2"', 'model = "nova3"', "key 'robot.model': unknown robot 'nova3'; known: nova2"),
        ('model = "w"', 'model = "r84"', "key 'end_effector.model': unknown end-effector 'r84'; known: r85"),
        ('model = "nova2"', 'model = "arm.urdf"', "section 'robot': robot file"),
        ('model = "w"', 'model = "tool.toml"', "section 'end_effector': "),
        ('model = "nova2"', 'model = "nova2"\ntip = "flang"', "no link 'flang' for the tip; known: flange"),
        ('model = "nova2"', 'model = "nova2"\nhome = [0.0]', "has 1 values; give 6"),
        ('model = "nova2"', 'model = "nova2"\nhome = [0, 3, 0, 0, 0, 0]', "joint2 at 3, outside its limits"),
        (
            'model = "nova2"',
            'model = "nova2"\nignore_collisions = [["link2"]]',
            "ignore_collisions.0.1' is missing",
        ),
    ],
)
def test_wrong_keys_and_values_are_named(write, old, new, said):
    assert said in refusal(write(changed(old, new)))


@pytest.mark.parametrize(
    ("obstacle", "said"),
    [
        (BOX.replace('"box"', '"sphere"'), "key 'obstacles.0.type': should be 'box', 'cylinder' or 'mesh'"),
        (BOX.replace("size", "sizes"), "unknown key 'obstacles.0.sizes'; allowed: size, "),
        (BOX.replace("size = [0.2, 0.3, 0.2]", "radius = 0.1"), "a box needs the key 'size'"),
        (BOX + "radius = 0.1\n", "a box has no key 'radius'; allowed: size"),
        (CYLINDER.replace("radius = 0.03", "radius = 0.0"), "obstacles.0.radius': should be greater than 0"),
        (BOX + BOX, "the name 'crate' is taken"),
        (BOX.replace("crate", "table"), "the name 'table' is taken"),
        (MESH, "of obstacle 'part' does not exist"),
    ],
)
def test_wrong_obstacles_are_named(write, obstacle, said):
    assert said in refusal(write(BUILT_IN + obstacle))


def test_unreadable_meshes_are_named(write, part):
    part.write_text("solid nothing\nendsolid nothing\n")
    assert "of obstacle 'part'" in refusal(write(BUILT_IN + MESH))
    odd = part.with_suffix(".txt")
    odd.write_text("no mesh")
    assert "cannot be read" in refusal(write(BUILT_IN + MESH.replace("part.stl", "part.txt")))


def test_files_that_are_no_workcell_are_refused(write, tmp_path):
    assert "cannot be read" in refusal(tmp_path / "none.toml")
    message = refusal(write(changed("schema = 1", "schema = ")))
    assert "not valid TOML" in message
    assert "line 3" in message


@pytest.mark.parametrize(
    ("home", "pair"),
    [
        ("[0, 0, 2.618, 1.5, 0, 0]", ("link1", "link5")),
        ("[0, 2.0, 0, 0, 0, 0]", ("link3", "table")),
    ],
)
def test_a_home_in_collision_is_refused(write, home, pair):
    message = refusal(write(changed('model = "nova2"', f'model = "nova2"\nhome = {home}')))
    assert f"'{pair[0]}' collides with '{pair[1]}'" in message
    assert "'robot.home'" in message


def test_obstacles_of_every_type_stop_the_home(write, part):
    at_tool, at_elbow = "position = [0.0, 0.35, 0.35]", "position = [0.0, 0.0, 0.5]"
    for text, position in (
        (BOX, "[0.5, 0.8, 0.1]"),
        (CYLINDER, "[-0.5, 0.8, 0.2]"),
        (MESH, "[0.6, 0.0, 0.1]"),
    ):
        for place in (at_tool, at_elbow):
            blocked = text.replace(f"position = {position}", place)
            name = blocked.split('name = "')[1].split('"')[0]
            assert f"collides with '{name}'" in refusal(write(BUILT_IN + blocked))
