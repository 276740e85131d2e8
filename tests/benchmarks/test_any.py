"""`bench any` at a size of seconds, and what it is made of: meshes, scenes, tables."""

from types import SimpleNamespace

import numpy as np
import pytest

from regrasp_opt.benchmarks.comparisons import any as any_module
from regrasp_opt.benchmarks.comparisons.any import AnySizes, contenders, from_fallback, run_any
from regrasp_opt.benchmarks.comparisons.unseen import FAMILIES, FEWEST, MOST, VARIANTS, made_meshes, random_scene
from regrasp_opt.benchmarks.comparisons.unseen_tables import any_tables
from regrasp_opt.benchmarks.harness.report import write_report
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.planning import problem
from regrasp_opt.scene.collision_world import collision_at_home

PLANNERS = ["arm energy", "exact", "constant energy", "random poses"]


def made_up_process(label, arguments, environment=None):
    """Return the row of a process that plans for whatever it is told to."""
    return {"process": label, "seconds": float(len(arguments)), "peak_mb": 300.0, "exit": 0}


@pytest.mark.filterwarnings("ignore")
def test_meshes_scenes_and_built_in_objects_are_planned(tmp_path, monkeypatch):
    meshes = tmp_path / "meshes" / "below"
    meshes.mkdir(parents=True)
    (meshes / "broken.stl").write_text("solid nothing", encoding="utf-8")
    for name, mesh in made_meshes(3, 0).items():
        if name.startswith("constructed"):
            mesh.export(meshes / f"{name}.stl")
    tiny = AnySizes(3, 3, 1, pairs=1, warm=1, truth=60, pool=20, time_limit=20.0)
    monkeypatch.setattr(any_module, "QUICK", tiny)
    monkeypatch.setattr(problem, "DEFAULT_GRASPS", 50)
    monkeypatch.setattr(any_module, "process_row", made_up_process)
    session = Session(tmp_path, quick=True, objects=meshes.parent, names=("bottle",), jobs=1, quiet=True)
    report = run_any(session)
    assert {row["object"] for row in report.errors} == {"broken"}
    plans = [row for row in report.rows if "planner" in row]
    by_part = {part: [row["planner"] for row in plans if row["part"] == part] for part in ("built-in", "scenes")}
    assert by_part == {part: [PLANNERS[0], "own energy", *PLANNERS[1:]] for part in by_part}
    ours = [row for row in plans if row["planner"] == "arm energy"]
    assert all(row["solved"] and row["minimum"] is not None for row in ours)
    [first] = (row for row in report.rows if row.get("object") == "constructed-0" and "faces" in row)
    assert first["first"] == pytest.approx(first["read"] + first["sampling"] + first["plan"])
    assert first["placements"] > 1 and first["grasps"] == 50
    assert {row["seconds"] for row in report.rows if "exit" in row} == {7.0}
    [moved] = (row for row in report.rows if "moved" in row)
    assert moved["moved"] > 0 and FEWEST <= moved["obstacles"] <= MOST
    assert write_report(report, tmp_path / "any")["rows"] == len(report.rows)
    again = run_any(session)  # read from the files of the first run, but for the mesh that was refused
    assert again.rows == report.rows


def test_contenders_differ_in_their_energy_alone(bottle_problem):
    ways = contenders(bottle_problem, bottle_problem)
    T = bottle_problem.placement_poses
    constant = ways["constant energy"].problem
    assert np.ptp(constant.energy(T)) == 0 < np.ptp(bottle_problem.energy(T))
    assert constant.rules is bottle_problem.rules and constant.grasps is bottle_problem.grasps
    assert all(way.problem is bottle_problem for label, way in ways.items() if label != "constant energy")


def test_a_plan_from_the_fallback_is_known():
    refined = {"num_regrasps": 1, "refiner": "nlp", "stages": ["lattice", "nlp"]}
    unrefined = {"num_regrasps": 1, "refiner": "lattice", "accepted": 3}
    assert from_fallback(SimpleNamespace(refiner_stats=[refined, unrefined]))
    assert not from_fallback(
        SimpleNamespace(refiner_stats=[refined, {"refiner": "lattice"}, {**refined, "accepted": 0}])
    )


def test_made_meshes_are_solids_and_the_same_for_the_same_seed():
    meshes = made_meshes(10**6, 0)
    assert len(meshes) == VARIANTS * len(FAMILIES) == 54
    assert all(mesh.is_volume and mesh.extents.max() < 0.25 for mesh in meshes.values())
    faces = sorted(len(mesh.faces) for mesh in meshes.values())
    assert faces[0] < 20 and faces[-1] > 20_000
    few = made_meshes(8, 0)
    assert list(few) == list(meshes)[:8]
    for name, mesh in few.items():
        np.testing.assert_array_equal(mesh.vertices, meshes[name].vertices)
    other = made_meshes(8, 1)
    assert not np.array_equal(other["superquadric-0"].vertices, few["superquadric-0"].vertices)


def test_scenes_leave_the_robot_at_home_alone(bottle_problem):
    scenes = [random_scene(bottle_problem, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    assert all(FEWEST <= len(scene) <= MOST for scene in scenes)
    assert [s.pose.tolist() for s in scenes[0]] == [s.pose.tolist() for s in scenes[1]] != scenes[2]
    cell = bottle_problem.with_obstacles(scenes[2]).workcell
    assert len(cell.obstacles) == len(scenes[2]) and collision_at_home(cell) is None


def _plan(planner, solved, N, minimum, seconds=1.0, part="meshes", **more):
    row = {"part": part, "object": "key", "pair": "key/any/0", "planner": planner, "status": "x", "solved": solved}
    return {**row, "num_regrasps": N, "minimum": minimum, "seconds": seconds, "unrefined": False, **more}


def test_tables_tell_shares_of_what_can_be_planned():
    rows = [
        _plan("arm energy", True, 1, 1, 0.1),
        _plan("arm energy", True, 2, 1, 0.3, unrefined=True),
        _plan("arm energy", False, None, 1),
        _plan("arm energy", True, 1, 2, 0.2),
        _plan("arm energy", True, 0, 0, 0.4),
        _plan("own energy", True, 1, 1, 0.06, part="built-in", processor=0.05),
        {"part": "meshes", "object": "key", "faces": 4, "placements": 2, "grasps": 9, "share": 0.25, "sampling": 1.0,
         "read": 0.5, "plan": 2.0, "first": 3.5, "processor": 3.0},
        {"part": "meshes", "object": "key", "process": "plan", "seconds": 6.0, "exit": 0},
        {"part": "meshes", "object": "lid", "process": "plan", "seconds": 9.0, "exit": 1},
        {"part": "scenes", "object": "scene 0, mug", "pair": "p", "obstacles": 3, "moved": None, "processor": 1.0},
        {"part": "meshes", "object": "ball", "error": "no stable placement"},
    ]  # fmt: skip
    found = {table.title: {line[0]: line[1:] for line in table.rows} for table in any_tables(rows)}
    times = found["Time to a verified plan"]
    assert times["mesh file to plan, warm process"] == (1, 1, 3.5, 3.5, 3.5, 3.0)
    assert times["mesh file to plan, whole process"] == (2, 1, 6.0, 6.0, 6.0, None)
    assert times["obstacles put in to plan"] == (1, 0, None, None, None, None)
    assert times["built-in object, one regrasp, own energy"] == (1, 1, 0.06, 0.06, 0.06, 0.05)
    assert found["Success by planner"]["meshes"] == ("arm energy", 5, 80, 75, 1, 25, 0.25, 0.385)
    assert found["Meshes"]["key"] == (4, 2, 9, 1.0, 2.0, 3.5, 25.0, "4 of 5")
    [title] = (title for title in found if title.startswith("Pairs"))
    assert found[title] == {"meshes": ("key/any/0", "x", None, 1, 1.0)}
    assert found["Not planned"] == {"meshes": ("ball", "no stable placement")}
