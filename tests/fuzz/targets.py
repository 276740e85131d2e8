"""What is fuzzed: each reader of the package with good files of its own, and how these are damaged."""

from __future__ import annotations

import json
import shutil
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
import trimesh
import yaml
from grasp_files import Z_APPROACH_X_CLOSING, acronym_json, graspgen, hand_poses, isaac, write, write_acronym
from scene_texts import BODIES, collision_object, mjcf, planning_scene, scene_text

from regrasp_opt.conventions import translation
from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.energy.storage import load_energy
from regrasp_opt.files import UNREADABLE_ARRAYS
from regrasp_opt.grasps import GraspSet
from regrasp_opt.io.scene_files import read_obstacles
from regrasp_opt.motion import MotionPlan, plan_motion
from regrasp_opt.objects import load_object
from regrasp_opt.objects.builtin import build
from regrasp_opt.planning import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.given_grasps import usable_grasps
from regrasp_opt.planning.model_store import REPORT_FILE
from regrasp_opt.planning.pose_text import parse_pose
from regrasp_opt.robots import load_robot
from regrasp_opt.scene import as_obstacles, load_workcell

from . import mutations as damage
from .commands import command_lines, run_command_line
from .trials import DATA, write_obstacles

_MODEL = DATA / "models" / "bottle-nova2-w"
Damage = Callable[[bytes, np.random.Generator], bytes]


@dataclass(frozen=True)
class Target:
    """A reader under test.

    Attributes
    ----------
    read : callable
        Takes the path of a file; may raise nothing but a `RegraspError`.
    seeds : callable
        Returns the good files that are damaged, as (suffix, content); a folder to work in is given.
    damages : tuple of callables
        What is done to them, one to three of these in turn.
    """

    read: Callable[[Path], Any]
    seeds: Callable[[Path], list[tuple[str, bytes]]]
    damages: tuple[Damage, ...]


def _meshes(folder: Path) -> list[tuple[str, bytes]]:
    box = trimesh.creation.box((0.04, 0.05, 0.1))
    ring = trimesh.creation.annulus(0.02, 0.03, 0.05, sections=8)
    found = [(f".{kind}", _exported(mesh, kind)) for mesh in (box, ring) for kind in ("stl", "obj", "ply", "glb")]
    return [*found, (".stl", _exported(box, "stl_ascii")), (".stl", _exported(build("pentagon"), "stl"))]


def _exported(mesh: trimesh.Trimesh, kind: str) -> bytes:
    content = mesh.export(file_type=kind)
    return content if isinstance(content, bytes) else str(content).encode()


def _read_mesh(path: Path) -> None:
    load_object(path, repair=len(path.read_bytes()) % 2 == 0)


def _read_obstacle(path: Path) -> None:
    """Load a workcell, written beside the folder of the file, that has the mesh `path` for an obstacle."""
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
    text += f'\n[[obstacles]]\ntype = "mesh"\nname = "part"\nposition = [0.5, 0.5, 0.1]\nfile = "{path}"\n'
    cell = path.parent.parent / "cell.toml"
    cell.write_text(text, encoding="utf-8")
    load_workcell(cell)


def _read_link(path: Path) -> None:
    """Load a robot, written beside the folder of the file, whose upper arm has the mesh `path` for a body."""
    cylinder = '<cylinder radius="0.02" length="0.2"/>'
    robot = path.parent.parent / "arm.urdf"
    robot.write_text(_ARM.replace(cylinder, f'<mesh filename="{path}"/>'), encoding="utf-8")
    load_robot(robot)


def _files(kind: str) -> list[tuple[str, bytes]]:
    return [(".toml", path.read_bytes()) for path in sorted((DATA / kind).glob("*.toml"))]


def _workcells(folder: Path) -> list[tuple[str, bytes]]:
    return [*_files("workcells")[:3], *[(".toml", write_obstacles(folder / "obstacles.toml").read_bytes())] * 3]


def _end_effectors(folder: Path) -> list[tuple[str, bytes]]:
    return _files("end_effectors")


_ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><collision><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.02" length="0.2"/></geometry>
</collision></link>
<link name="tool0"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="b" type="continuous"><parent link="upper"/><child link="tool0"/><origin xyz="0 0 0.2" rpy="0 0.1 0"/>
<axis xyz="0 1 0"/></joint></robot>"""


def _robots(folder: Path) -> list[tuple[str, bytes]]:
    return [(".urdf", (DATA / "robots/nova2/nova2.urdf").read_bytes()), *[(".urdf", _ARM.encode())] * 2]


def _saved_plans(folder: Path) -> Iterator[Path]:
    """Save a plan with few grasps to a file and yield that, then what is saved when nothing was found."""
    whole = RegraspProblem.load("bottle", "nova2-w")
    problem = RegraspProblem.load("bottle", "nova2-w", grasps=whole.grasps.subset(np.arange(0, 200, 20)))
    for goal in (whole.pose(0, -0.2, 0.35, 0.3), whole.pose(2, -0.2, 0.35)):
        solve_sequence(problem, whole.pose(0, 0.2, 0.35), goal, max_regrasps=1).save(folder / "plan.json")
        yield folder / "plan.json"


def _plans(folder: Path) -> list[tuple[str, bytes]]:
    return [(".json", path.read_bytes()) for path in _saved_plans(folder)]


def _read_plan(path: Path) -> None:
    RegraspPlan.load(path).residuals()


def _motions(folder: Path) -> list[tuple[str, bytes]]:
    """Return a motion, and what it is when there is no plan."""
    found = []
    for path in _saved_plans(folder):
        plan_motion(RegraspPlan.load(path)).save(folder / "motion.json")
        found.append((".json", (folder / "motion.json").read_bytes()))
    return found


def _read_motion(path: Path) -> None:
    motion = MotionPlan.load(path)
    if motion.solved:
        motion.save_csv(path.parent.parent / "motion.csv", motion.duration / 20)


def _energies(folder: Path) -> list[tuple[str, bytes]]:
    return [(".safetensors", path.read_bytes()) for path in sorted(_MODEL.glob("*.safetensors"))]


def _reports(folder: Path) -> list[tuple[str, bytes]]:
    return [(".json", (_MODEL / REPORT_FILE).read_bytes())]


def _read_model(path: Path) -> None:
    """Load a prepared model, copied beside the folder of the file, that has `path` for its report."""
    model = path.parent.parent / "model"
    if not model.exists():
        shutil.copytree(_MODEL, model)
    shutil.copyfile(path, model / REPORT_FILE)
    problem = RegraspProblem.load("bottle", "nova2-w", model=model)
    problem.energy(_PLACEMENTS)


def _grasps(folder: Path) -> list[tuple[str, bytes]]:
    return [(".npz", (_MODEL / "grasps.npz").read_bytes())]


def _foreign_grasps(folder: Path) -> list[tuple[str, bytes]]:
    grasps = GraspSet.load(_MODEL / "grasps.npz").subset(np.arange(0, 200, 40))
    T, count = hand_poses(grasps.T_object_tcp, 0.1034, Z_APPROACH_X_CLOSING), np.ones(len(grasps))
    grasps.save(folder / "grasps.csv")
    found = [(".csv", (folder / "grasps.csv").read_bytes())]
    for name, content in (
        ("a.json", acronym_json(T, count)),
        ("b.json", graspgen(T, count, gripper={"depth": 0.1034})),
        ("c.yaml", isaac(T, count, gripper_frame="/World/franka_panda")),
    ):
        found.append((Path(name).suffix, write(folder / name, content).read_bytes()))
    return found


def _acronym(folder: Path) -> list[tuple[str, bytes]]:
    grasps = GraspSet.load(_MODEL / "grasps.npz").subset(np.arange(0, 200, 40))
    T = hand_poses(grasps.T_object_tcp, 0.1034, Z_APPROACH_X_CLOSING)
    write_acronym(folder / "grasps.h5", T, np.ones(len(grasps)))
    return [(".h5", (folder / "grasps.h5").read_bytes())]


def _read_foreign_grasps(path: Path) -> None:
    """Put the grasps of a file on the bottle."""
    usable_grasps(GraspSet.load(path), load_object("bottle"), load_end_effector("w"))


def _scenes(folder: Path) -> list[tuple[str, bytes]]:
    bodies = BODIES[:2] + BODIES[3:]
    message = yaml.safe_dump(planning_scene([collision_object(body) for body in BODIES]))
    texts = [(".scene", scene_text()), (".scene", scene_text(old=True)), (".yaml", message), (".xml", mjcf(bodies))]
    return [(suffix, text.encode()) for suffix, text in texts]


def _read_scene(path: Path) -> None:
    as_obstacles(read_obstacles(path))


_PLACEMENTS = np.array([np.eye(4), translation(0.0, 0.01, 0.1), np.diag([1.0, -1.0, -1.0, 1.0])])


def _poses(folder: Path) -> list[tuple[str, bytes]]:
    matrix = json.dumps(_PLACEMENTS[2].tolist()).encode()
    return [(".txt", b"2:0.30,0.25,45"), (".txt", b"0:-0.1,4e-1,-720"), (".json", matrix)]


@cache
def _problem() -> RegraspProblem:
    return RegraspProblem.load("bottle", "nova2-w")


def _read_pose(path: Path) -> None:
    """Read a pose file, or take the content of any other file for what is typed on the command line."""
    text = str(path) if path.suffix == ".json" else path.read_bytes().decode("utf-8", "surrogateescape")
    parse_pose(text, "start", _problem())


_TEXT = (damage.damage_text, damage.damage_text, damage.damage_text, damage.damage_bytes)

TARGETS: dict[str, Target] = {
    "mesh": Target(_read_mesh, _meshes, (damage.damage_bytes, damage.damage_text)),
    "mesh of an obstacle": Target(_read_obstacle, _meshes, (damage.damage_bytes, damage.damage_text)),
    "mesh of a link": Target(_read_link, _meshes, (damage.damage_bytes, damage.damage_text)),
    "workcell": Target(load_workcell, _workcells, _TEXT),
    "end-effector": Target(load_end_effector, _end_effectors, _TEXT),
    "robot": Target(load_robot, _robots, (damage.damage_xml, damage.damage_text, damage.damage_bytes)),
    "plan": Target(_read_plan, _plans, (damage.damage_json, damage.damage_json, damage.damage_text)),
    "motion": Target(_read_motion, _motions, (damage.damage_json, damage.damage_json, damage.damage_text)),
    "energy": Target(load_energy, _energies, (damage.damage_safetensors, damage.damage_bytes)),
    "report of a model": Target(_read_model, _reports, (damage.damage_json, damage.damage_text, damage.damage_bytes)),
    "grasp set": Target(GraspSet.load, _grasps, (damage.damage_arrays, damage.damage_arrays, damage.damage_bytes)),
    "grasps of other tools": Target(_read_foreign_grasps, _foreign_grasps, (damage.damage_text, damage.damage_bytes)),
    "grasps in HDF5": Target(_read_foreign_grasps, _acronym, (damage.damage_bytes,)),
    "scene": Target(_read_scene, _scenes, (damage.damage_text, damage.damage_bytes)),
    "pose": Target(_read_pose, _poses, (damage.damage_text, damage.damage_bytes)),
    "command line": Target(run_command_line, command_lines, (damage.damage_words,)),
}
"""The readers by the name under which they are reported."""


TOO_BROKEN = (*UNREADABLE_ARRAYS, RecursionError, ParseError)
"""What damage that knows a format raises on a file that no longer has it."""


@cache
def seeds(name: str, folder: Path) -> list[tuple[str, bytes]]:
    """Return the good files of a target; made once a process, in `folder` where that is needed."""
    return TARGETS[name].seeds(folder)


def case(name: str, seed: int, number: int, folder: Path) -> tuple[str, bytes]:
    """Return suffix and content of the damaged file `number` of a target."""
    rng = np.random.default_rng([seed, 60, zlib.crc32(name.encode()), number])
    good = seeds(name, folder)
    suffix, content = good[rng.integers(len(good))]
    if rng.random() < 0.03:
        suffix = good[rng.integers(len(good))][0] if rng.integers(2) else ".stl"
    for _ in range(int(rng.integers(1, 4))):
        options = TARGETS[name].damages
        try:
            content = options[rng.integers(len(options))](content, rng)
        except TOO_BROKEN:
            content = damage.damage_bytes(content, rng)
    return suffix, content
