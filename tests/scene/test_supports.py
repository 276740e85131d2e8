"""Workcells of several supports: boards, level and tilted, and fixtures; what is read, and what is refused."""

import numpy as np
import pytest

from regrasp_opt.conventions import rotation_rpy
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.scene import Fixture, Support, load_workcell
from regrasp_opt.scene.collision_world import CollisionWorld, ContactPhase
from regrasp_opt.scene.record import SceneRecord, scene_changes, scene_content

CELL = """
schema = 2

[[arms]]
robot = "nova2"
end_effector = "w"

[[supports]]
name = "table"
center = [0.0, 0.35]
size = [1.0, 0.7]
workspace = { x = [-0.40, 0.05], y = [0.15, 0.55] }

[[supports]]
name = "plate"
height = 0.06
center = [0.30, 0.40]
size = [0.30, 0.20]
thickness = 0.02
rpy = [0.1745, 0.0, 0.3]
weight = 0.5

[[supports]]
kind = "fixture"
name = "nest"
position = [-0.15, 0.45, 0.03]
rpy = [0.2618, 0.0, 0.0]
bodies = [{ type = "box", name = "floor", position = [0.0, 0.0, -0.005], size = [0.09, 0.09, 0.01] }]
poses = [{ name = "leaning", position = [0.0, 0.0, 0.0005], object = "bottle" }]
"""


@pytest.fixture
def load(tmp_path):
    def from_text(*changes):
        text = CELL
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "cell.toml").write_text(text, "utf-8")
        return load_workcell(tmp_path / "cell.toml")

    return from_text


def test_boards_and_fixtures_are_read(load):
    table, plate, nest = load().supports
    assert isinstance(table, Support) and isinstance(plate, Support) and isinstance(nest, Fixture)
    np.testing.assert_array_equal(table.T_world_support, np.eye(4))
    np.testing.assert_allclose(plate.T_world_support[:3, :3], rotation_rpy(0.1745, 0.0, 0.3))
    np.testing.assert_allclose(plate.T_world_support @ [0.30, 0.40, 0.0, 1.0], [0.30, 0.40, 0.06, 1.0], atol=1e-12)
    np.testing.assert_allclose(plate.workspace.array, [[0.20, 0.35], [0.40, 0.45]])
    assert plate.slope == pytest.approx(np.tan(0.1745), abs=1e-4) and plate.weight == 0.5
    corner = plate.shape.pose @ [0.15, 0.10, 0.01, 1.0]  # of the upper face
    np.testing.assert_allclose(plate.seen(corner[:3]), [0.45, 0.50, 0.0], atol=1e-12)
    (held,) = nest.poses
    assert nest.holding(nest.T_world_support @ held.T_support_object, 1e-9) is held
    assert nest.holding(nest.T_world_support, 1e-4) is None


def test_supports_are_found_by_name(load):
    cell = load()
    assert cell.support(None) is cell.table is cell.supports[0]
    assert cell.support("nest") is cell.supports[2]
    with pytest.raises(UnknownNameError, match="'shelf'"):
        cell.support("shelf")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([('"plate"', '"table"')], "the name 'table' is taken"),
        ([("height = 0.06", "height = 0.005")], "key 'supports.1': 'plate' overlaps 'table'"),
        ([("rpy = [0.1745, 0.0, 0.3]", "rpy = [0.6, 0.0, 0.0]")], "'plate' is tilted by 34.4 degrees"),
        ([("rpy = [0.1745, 0.0, 0.3]", "rpy = [3.0, 0.0, 0.0]")], "'plate' is tilted by 171.9 degrees"),
        ([("x = [-0.40, 0.05]", "x = [-0.60, 0.05]")], "key 'supports.0.workspace.x': -0.6 to 0.05 leaves the table"),
        ([("position = [-0.15, 0.45, 0.03]", "position = [-0.15, 2.45, 0.03]")], "'nest' is 2.4"),
        ([("center = [0.30, 0.40]", "center = [3.30, 0.40]")], "'plate' is 3.2"),
        ([("thickness = 0.02", "thickness = 0.02\nposition = [0, 0, 0]")], "a board has no key 'position'"),
        ([("position = [-0.15, 0.45, 0.03]", "")], "a fixture needs the key 'position'"),
        ([("center = [0.0, 0.35]", "")], "a board needs the key 'center'"),
        ([('robot = "nova2"', 'robot = "nova3"')], "key 'arms.0.robot'"),
        ([('end_effector = "w"', 'end_effector = "x"')], "key 'arms.0.end_effector'"),
        ([("schema = 2", "schema = 2\nlegs = 4")], "unknown key 'legs'"),
    ],
)
def test_what_does_not_fit_is_named_with_its_key(load, changes, said):
    with pytest.raises(WorkcellError, match=r"cell\.toml") as info:
        load(*changes)
    assert said in str(info.value)


def test_a_fixture_cannot_come_first(load):
    first = CELL.index("[[supports]]"), CELL.index("[[supports]]\nkind")
    with pytest.raises(WorkcellError, match="the first support is a fixture; put a board first"):
        load((CELL[first[0] : first[1]], ""))


def test_a_lifted_object_may_touch_its_own_support_only(load):
    from regrasp_opt.objects import load_object

    world = CollisionWorld(load(), load_object("bottle"))
    held = {j for i, j, _ in world.pairs(ContactPhase.LIFT, on=1) if i == world.object}
    assert held.isdisjoint(world.by_support[1])
    assert held >= {*world.by_support[0], *world.by_support[2]}
    carried = {j for i, j, _ in world.pairs(ContactPhase.CARRY) if i == world.object}
    assert carried >= set(world.supports)


def test_a_scene_is_recorded_with_its_supports(load):
    cell = load()
    record = SceneRecord.model_validate(scene_content(cell))
    assert scene_changes(record, cell) == []
    changed = load(("weight = 0.5", "weight = 0.6"), ("position = [0.0, 0.0, 0.0005]", "position = [0.0, 0.0, 0.001]"))
    assert scene_changes(record, changed) == [
        "weight of support 'plate' is 0.6 instead of 0.5",
        "the poses of support 'nest' is another",
    ]
    assert cell.fingerprint() != changed.fingerprint()
