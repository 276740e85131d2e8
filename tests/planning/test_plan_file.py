"""Plan files: nothing is lost on the way, and whatever is wrong with one is said in one sentence."""

import copy
import json
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import trimesh
from oracles.plans import PlanVerifier

from regrasp_opt import RegraspPlan, RegraspProblem, Status, load_workcell, solve_sequence
from regrasp_opt.conventions import planar_transform, rotation_rpy, translation
from regrasp_opt.errors import PlanFileError, RegraspError, WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh
from regrasp_opt.planning.plan_file import plan_summary
from regrasp_opt.planning.problem import assemble

BUILT_IN = (files("regrasp_opt") / "data" / "workcells" / "nova2-w.toml").read_text("utf-8")


def assert_equal_plans(a, b):
    for name in ("status", "num_regrasps", "timings", "refiner_stats", "seed"):
        assert getattr(a, name) == getattr(b, name)
    assert a.cost == b.cost or (np.isnan(a.cost) and np.isnan(b.cost))
    for name in ("poses", "placements", "xi"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-15)
    for one, other in zip(a.transitions, b.transitions, strict=True):
        for name in ("grasp_ids", "q_pick", "q_place", "clearance"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_plan_comes_back_as_it_was_saved(plan, tmp_path):
    path = tmp_path / "plan.json"
    plan.save(path)
    again = RegraspPlan.load(path)
    assert_equal_plans(again, plan)
    assert again.residuals().hold
    assert again.problem.object.fingerprint() == plan.problem.object.fingerprint()
    assert again.problem.workcell.fingerprint() == plan.problem.workcell.fingerprint()
    np.testing.assert_allclose(again.problem.grasps.T_object_tcp, plan.problem.grasps.T_object_tcp, atol=1e-15)
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]


def test_plans_that_are_not_solved_come_back(bottle_problem, task, tmp_path):
    unsolved = solve_sequence(bottle_problem, task.start, task.goal, max_regrasps=0)
    timed_out = solve_sequence(bottle_problem, task.start, task.goal, time_limit=1e-6)
    for plan in (unsolved, timed_out):
        plan.save(tmp_path / "plan.json")
        again = RegraspPlan.load(tmp_path / "plan.json")
        assert_equal_plans(again, plan)
        assert again.status in (Status.NOT_FOUND, Status.TIME_LIMIT)


def test_the_file_has_the_keys_of_the_contract(plan, plan_content):
    keys = ["status", "num_regrasps", "cost", "poses", "transitions", "timings"]
    assert list(plan_summary(plan)) == keys
    assert set(keys) < set(plan_content)
    assert plan_content["schema"] == 3 and plan_content["status"] == "solved"
    assert set(plan_content["transitions"][0]) == {"grasp_ids", "q_pick", "q_place", "clearance"}


def test_an_own_mesh_and_workcell_are_found_again_from_another_folder(bottle_problem, plan, tmp_path, monkeypatch):
    mesh, cell = tmp_path / "bottle.stl", tmp_path / "cell.toml"
    bottle_problem.object.mesh.export(mesh)
    cell.write_text(BUILT_IN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    own = RegraspProblem.load("bottle.stl", "cell.toml", grasps=bottle_problem.grasps)
    replace(plan, problem=own).save("plan.json")
    monkeypatch.chdir("/")
    again = RegraspPlan.load(tmp_path / "plan.json")
    assert again.residuals().hold
    trimesh.creation.box((0.05, 0.05, 0.1)).export(mesh)
    assert "object 'bottle' has changed" in refusal(tmp_path / "plan.json")
    bottle_problem.object.mesh.export(mesh)
    cell.write_text(BUILT_IN.replace("arm = 0.005", "arm = 0.004"), encoding="utf-8")
    refused = refusal(tmp_path / "plan.json")
    assert re.search(r"workcell '\S+' has changed since .* \(clearance\.arm is 0\.004 instead of 0\.005\)", refused)
    cell.unlink()
    with pytest.raises(RegraspError, match=r"cell\.toml"):
        RegraspPlan.load(tmp_path / "plan.json")


def refusal(path):
    with pytest.raises(PlanFileError) as info:
        RegraspPlan.load(path)
    assert "\n" not in str(info.value) and len(str(info.value)) < 400
    return str(info.value)


def test_files_that_are_no_plan(tmp_path, plan_content):
    path = tmp_path / "plan.json"
    assert "cannot read the plan" in refusal(path)
    assert "cannot read the plan" in refusal(tmp_path)
    text = json.dumps(plan_content)
    for broken in ("", text[: len(text) // 2], "no json", "[" * 100_000, text.replace("{", "[", 1)):
        path.write_text(broken, encoding="utf-8")
        assert "not valid JSON" in refusal(path)
    path.write_bytes(b"\xff\xfe\x00" * 20)
    assert "not valid JSON" in refusal(path)
    for other in ("null", "3", "[]", "{}", '"plan"', '{"schema": 4}', '{"schema": "1"}', '{"schema": true}'):
        path.write_text(other, encoding="utf-8")
        assert "schema" in refusal(path)


def put(value, *keys):
    """Return a change that puts `value` at `keys` of a plan's content."""

    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


def drop(*keys):
    def change(content):
        for key in keys[:-1]:
            content = content[key]
        del content[keys[-1]]

    return change


NAN, HUGE = float("nan"), 10**400
WRONG = {
    "missing field": (drop("poses"), "'poses'"),
    "missing transition field": (drop("transitions", 0, "q_pick"), r"'transitions\.0\.q_pick'"),
    "unknown field": (put(1, "colour"), "'colour'"),
    "text for a number": (put("far", "transitions", 0, "q_pick", 0, 2), r"transitions\.0\.q_pick\.0\.2"),
    "nan joint": (put(NAN, "transitions", 0, "q_pick", 0, 2), r"transitions\.0\.q_pick\.0\.2"),
    "nan cost": (put(NAN, "cost"), "'cost'"),
    "infinite clearance": (put(float("inf"), "transitions", 0, "clearance", 0), "clearance"),
    "nan pose": (put(NAN, "poses", 1, 0, 3), "poses"),
    "huge pose": (put(HUGE, "poses", 1, 0, 3), ""),
    "mirrored pose": (put([[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "poses", 1), "left-handed"),
    "small pose": (put([[1, 0], [0, 1]], "poses", 1), "pose 1 has shape"),
    "ragged pose": (put([[1, 0], [0]], "poses", 1), "pose 1"),
    "no poses": (put([], "poses"), "disagree"),
    "unknown status": (put("finished", "status"), "unknown status 'finished'; known: solved"),
    "another count": (put(3, "num_regrasps"), "disagree"),
    "a pose too few": (drop("poses", 1), "disagree"),
    "a transition too few": (drop("transitions", 0), "disagree"),
    "a placement too many": (put([0, 0, 0, 0], "placements"), "disagree"),
    "a negative placement": (put([-1], "placements"), ""),
    "a huge placement": (put([HUGE], "placements"), ""),
    "xi of two numbers": (put([[0.1, 0.2]], "xi"), "xi"),
    "xi of no numbers": (put([[]], "xi"), "xi"),
    "a grasp too many": (put([0] * 400, "transitions", 0, "grasp_ids"), "do not fit"),
    "a joint too few": (put([0.0] * 5, "transitions", 0, "q_place", 0), "do not fit"),
    "an unknown grasp": (put(200, "transitions", 0, "grasp_ids", 0), "names a grasp that the file does not hold"),
    "a negative grasp": (put(-1, "transitions", 0, "grasp_ids", 0), ""),
    "a huge grasp": (put(HUGE, "transitions", 0, "grasp_ids", 0), ""),
    "a sheared grasp": (put([1, 1, 0, 0], "grasps", 0, "T_object_tcp", 0), "grasp 0"),
    "a negative width": (put(-0.1, "grasps", 0, "width"), ""),
    "another object": (put("0" * 64, "object", "fingerprint"), "object 'bottle' has changed since the plan"),
    "another workcell": (put("0" * 64, "workcell", "arms", 0, "robot", "fingerprint"), "robot of arm 'arm' is another"),
    "another scale": (put(0.9, "object", "scale"), "object 'bottle' has changed"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_content_is_named(name, plan_content, tmp_path):
    change, said = WRONG[name]
    content = copy.deepcopy(plan_content)
    change(content)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    message = refusal(path)
    assert re.search(said, message), message


def own_plan(plan, cell, tmp_path, text):
    """Save `plan` as one in the workcell file `cell`, of content `text`; return its path."""
    cell.write_text(text, encoding="utf-8")
    problem = assemble(plan.problem.object, load_workcell(cell), plan.problem.grasps, None)
    path = tmp_path / "plan.json"
    replace(plan, problem=problem).save(path)
    return path


SHELF_ALONE = """
[[obstacles]]
type = "box"
name = "shelf"
size = [0.1, 0.2, 0.05]
position = [0.0, -0.4, 0.3]
rpy = [0.3, 1.5707963267948966, -0.2]
"""
POST = 'type = "cylinder"\nname = "post"\nradius = 0.02\nlength = 0.5\n'
SHELVES = f"""{SHELF_ALONE}
[[obstacles]]
{POST}position = [0.5, -0.4, 0.25]
[[obstacles]]
type = "mesh"
name = "motor"
file = "motor.stl"
scale = 0.001
position = [-0.5, -0.4, 0.1]
"""
CHANGED = {
    "moved": ("[0.0, -0.4, 0.3]", "[0.0, -0.42, 0.3]", "obstacle 'shelf' moved by 0.02 m"),
    "turned": ("-0.2]", "-0.3]", "obstacle 'shelf' turned by 5.73 degrees"),
    "resized": ("0.2, 0.05]", "0.2, 0.06]", "size of obstacle 'shelf' is [0.1, 0.2, 0.06] instead of [0.1, 0.2, 0.05]"),
    "thicker": ("radius = 0.02", "radius = 0.025", "radius of obstacle 'post' is 0.025 instead of 0.02"),
    "another type": (POST, POST.split("radius")[0].replace("cylinder", "box") + "size = [0.1, 0.1, 0.1]\n",
                     "obstacle 'post' is a box instead of a cylinder"),
    "another mesh": ("0.001", "0.0011", "the mesh of obstacle 'motor' is another"),
    "removed": (SHELF_ALONE, "", "obstacle 'shelf' was removed"),
    "added": (SHELF_ALONE, SHELF_ALONE + SHELF_ALONE.replace("shelf", "rack").replace("0.3]", "0.5]"),
              "obstacle 'rack' was added"),
    "base": ("position = [0.0, 0.0, 0.0]", "position = [0.0, 0.0, 0.01]", "arm 'arm' moved by 0.01 m"),
    "robot": ('model = "nova2"', 'model = "nova2"\nignore_collisions = [["link1", "link4"]]',
              "the robot of arm 'arm' is another"),
    "tool": ('model = "w"', 'model = "r85"', "end_effector of arm 'arm' is 'r85' instead of 'w'"),
    "table": ("thickness = 0.05", "thickness = 0.04", "thickness of support 'table' is 0.04 instead of 0.05"),
    "workspace": ("[-0.45, 0.45]", "[-0.4, 0.45]",
                  "x of the workspace of support 'table' is [-0.4, 0.45] instead of [-0.45, 0.45]"),
    "clearance": ("gripper = 0.003", "gripper = 0.004", "clearance.gripper is 0.004 instead of 0.003"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGED)
def test_what_changed_in_a_workcell_is_named(name, plan, tmp_path):
    trimesh.creation.icosphere(1, 50.0).export(tmp_path / "motor.stl")
    cell, text = tmp_path / "cell.toml", BUILT_IN + SHELVES
    path = own_plan(plan, cell, tmp_path, text)
    assert RegraspPlan.load(path).problem.workcell.fingerprint() == load_workcell(cell).fingerprint()
    old, new, said = CHANGED[name]
    assert text.count(old) == 1
    cell.write_text(text.replace(old, new), encoding="utf-8")
    assert refusal(path).endswith(f"was made ({said}); plan again")


def test_of_many_changes_three_are_named(plan, tmp_path):
    cell, boxes = tmp_path / "cell.toml", "".join(SHELF_ALONE.replace("shelf", f"shelf {i}") for i in range(5))
    path = own_plan(plan, cell, tmp_path, BUILT_IN + boxes)
    cell.write_text(BUILT_IN, encoding="utf-8")
    assert "'shelf 2' was removed, and 2 more)" in refusal(path)


def test_names_and_order_of_obstacles_may_change(plan, tmp_path):
    trimesh.creation.icosphere(1, 50.0).export(tmp_path / "motor.stl")
    cell = tmp_path / "cell.toml"
    path = own_plan(plan, cell, tmp_path, BUILT_IN + SHELVES)
    _, first, *rest = SHELVES.split("[[obstacles]]\n")
    turned = "".join("[[obstacles]]\n" + part for part in (*rest, first.replace("shelf", "rack")))
    cell.write_text(BUILT_IN + turned, encoding="utf-8")
    assert RegraspPlan.load(path).residuals().hold


def test_obstacles_that_no_file_has_come_back_with_the_plan(plan, tmp_path):
    ball = trimesh.creation.icosphere(1, 0.05)
    lying = planar_transform([0.4, -0.4, 1.0]) @ rotated(np.pi / 2)
    shapes = [
        Box("box", np.array([0.1, 0.2, 0.3]), translation(0.0, -0.5, 0.2)),
        Cylinder("pipe", 0.02, 0.3, lying),
        Mesh("ball", np.array(ball.vertices), np.array(ball.faces), translation(-0.5, -0.3, 0.1)),
    ]
    body, cell, grasps = plan.problem.object, plan.problem.workcell, plan.problem.grasps
    path = tmp_path / "plan.json"
    replace(plan, problem=assemble(body, cell.with_obstacles(shapes), grasps, None)).save(path)
    again = RegraspPlan.load(path)
    assert again.residuals().hold
    assert again.problem.workcell.added == ("box", "pipe", "ball")
    assert again.problem.workcell.fingerprint() == cell.with_obstacles(shapes).fingerprint()
    assert independent_problems(path) == []
    wall = Box("wall", np.array([0.6, 0.6, 0.6]), translation(*plan.poses[1][:3, 3]))
    replace(plan, problem=assemble(body, cell.with_obstacles([wall]), grasps, None)).save(path)
    assert any("wall" in text for text in RegraspPlan.load(path).residuals().problems)
    assert independent_problems(path)
    with pytest.raises(WorkcellError, match="the name 'wall' is taken"):
        cell.with_obstacles([wall]).with_obstacles([wall])


DAMAGES = {
    "moved": lambda shapes: shapes[1]["position"].__setitem__(2, 0.3),
    "moved a little": lambda shapes: shapes[0]["position"].__setitem__(0, 1e-7),
    "turned": lambda shapes: shapes[2]["rpy"].__setitem__(2, 0.1),
    "shrunk": lambda shapes: shapes[0].update(size=[1e-6, 1e-6, 1e-6]),
    "thinner": lambda shapes: shapes[1].update(radius=0.001),
    "another mesh": lambda shapes: shapes[2].update(fingerprint="0" * 64),
    "removed": lambda shapes: shapes.pop(1),
    "all removed": lambda shapes: shapes.clear(),
    "twice": lambda shapes: shapes.append({**shapes[0], "name": "more"}),
    "not added": lambda shapes: shapes[0].update(added=False),
}


@pytest.fixture(scope="module")
def with_added(plan, tmp_path_factory):
    """The content of a plan file with added obstacles of every type."""
    ball = trimesh.creation.icosphere(1, 0.05)
    shapes = [
        Box("box", np.array([0.1, 0.2, 0.3]), translation(0.0, -0.5, 0.2)),
        Cylinder("pipe", 0.02, 0.3, planar_transform([0.4, -0.4, 1.0]) @ rotated(np.pi / 2)),
        Mesh("ball", np.array(ball.vertices), np.array(ball.faces), translation(-0.5, -0.3, 0.1) @ rotated(0.3)),
    ]
    problem = assemble(plan.problem.object, plan.problem.workcell.with_obstacles(shapes), plan.problem.grasps, None)
    path = tmp_path_factory.mktemp("added") / "plan.json"
    replace(plan, problem=problem).save(path)
    return json.loads(path.read_text("utf-8"))


@pytest.mark.parametrize("name", DAMAGES)
def test_added_obstacles_that_were_changed_in_the_file_are_noticed(name, with_added, tmp_path):
    content = copy.deepcopy(with_added)
    DAMAGES[name](content["workcell"]["obstacles"])
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    assert refusal(tmp_path / "plan.json").endswith("were changed in its file; plan again")


def test_added_meshes_are_held_to_their_fingerprint(with_added, tmp_path):
    content = copy.deepcopy(with_added)
    content["workcell"]["obstacles"][2]["vertices"][0][0] = 0.1
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    assert "the mesh of obstacle 'ball' is another" in refusal(tmp_path / "plan.json")
    content = copy.deepcopy(with_added)
    del content["workcell"]["added_fingerprint"]
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    assert "'workcell.added_fingerprint'" in refusal(tmp_path / "plan.json")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"radius": 0.001, "length": 0.001}, "a box has no key 'radius'; allowed: size"),
        ({"type": "cylinder", "radius": 0.001, "length": 0.001}, "a cylinder has no key 'size'"),
    ],
)
def test_keys_of_another_type_are_refused(change, said, with_added, tmp_path):
    content = copy.deepcopy(with_added)
    content["workcell"]["obstacles"][0].update(change)
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    assert said in refusal(tmp_path / "plan.json")


def test_names_and_order_of_added_obstacles_may_change(with_added, tmp_path):
    content, path = copy.deepcopy(with_added), tmp_path / "plan.json"
    content["workcell"]["obstacles"].reverse()
    content["workcell"]["obstacles"][0]["name"] = "globe"
    path.write_text(json.dumps(content), encoding="utf-8")
    again = RegraspPlan.load(path)
    assert again.problem.workcell.added == ("globe", "pipe", "box")
    again.save(path)
    assert RegraspPlan.load(path).residuals().hold


def independent_problems(path):
    content = json.loads(path.read_text("utf-8"))
    return PlanVerifier(content).problems(content)


def rotated(pitch):
    T = np.eye(4)
    T[:3, :3] = rotation_rpy(0.0, pitch, 0.0)
    return T


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"faces": [[0, 1, 9]]}, "a face names a vertex that does not exist"),
        ({"faces": [[0, 1, -1]]}, "faces"),
        ({"vertices": []}, "needs the key 'vertices'"),
        ({"fingerprint": ""}, "needs the key 'fingerprint'"),
        ({"added": False}, "a mesh has no key 'vertices'; allowed: fingerprint"),
        ({"radius": 0.1}, "a mesh has no key 'radius'; allowed: fingerprint, vertices, faces"),
        ({"type": "box"}, "needs the key 'size'"),
        ({"type": "box", "size": [1.0, 1.0, 1.0]}, "a box has no key 'fingerprint'; allowed: size"),
        ({"type": "cylinder", "radius": -1.0, "length": 1.0}, "radius"),
        ({"position": [0.0, 0.0, 1e999]}, "position"),
        ({"name": "table"}, "the name 'table' is taken"),
    ],
)
def test_damaged_obstacles_are_refused(change, said, plan_content, tmp_path):
    content = copy.deepcopy(plan_content)
    shape = {"name": "net", "type": "mesh", "position": [0, -0.5, 0.3], "rpy": [0, 0, 0], "added": True}
    mesh = {"fingerprint": "0" * 64, "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
    content["workcell"]["obstacles"] = [{**shape, **mesh, **change}]
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(RegraspError) as info:
        RegraspPlan.load(tmp_path / "plan.json")
    assert said in str(info.value)


def test_plans_of_schema_1_are_read(tmp_path):
    """The file was written by the version before schema 2."""
    old = Path(__file__).with_name("plan-1.json")
    content = json.loads(old.read_text("utf-8"))
    assert content["schema"] == 1
    plan = RegraspPlan.load(old)
    assert plan.solved and plan.residuals().hold and independent_problems(old) == []
    plan.save(tmp_path / "plan.json")
    assert_equal_plans(RegraspPlan.load(tmp_path / "plan.json"), plan)
    content["workcell"]["fingerprint"] = "0" * 64
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    assert "the workcell 'nova2-w' has changed" in refusal(tmp_path / "plan.json")


def test_a_transition_without_grasps_is_read_and_refused_by_the_verification(plan_content, tmp_path):
    content = copy.deepcopy(plan_content)
    content["transitions"][0] = {"grasp_ids": [], "q_pick": [], "q_place": [], "clearance": []}
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    plan = RegraspPlan.load(path)
    empty = plan.transitions[0]
    assert empty.grasp_ids.dtype.kind == "i" and empty.q_pick.shape == empty.q_place.shape == (0, 6)
    assert plan.residuals().problems == ("transition 0: no grasp is shared by its two poses",)


@pytest.mark.parametrize("field", ["object", "workcell"])
def test_an_unknown_object_or_workcell_lists_the_known_ones(field, plan_content, tmp_path):
    content = copy.deepcopy(plan_content)
    content[field]["name"] = content[field]["name"] + "x"
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(RegraspError, match="known: ") as info:
        RegraspPlan.load(tmp_path / "plan.json")
    assert "\n" not in str(info.value)


def test_a_plan_that_cannot_be_written_leaves_the_old_one(plan, plan_content, tmp_path, monkeypatch):
    path = tmp_path / "plan.json"
    path.write_text("old", encoding="utf-8")
    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OSError, match="disk"):
        plan.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"] and path.read_text("utf-8") == "old"


def refuse(*_):
    raise OSError("disk full")
