"""Arms of other people: cells with a UR5, a Panda and an xArm7, and how well energies of theirs plan."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import NamedTuple

import numpy as np

from regrasp_opt.benchmarks.harness.instances import random_instances
from regrasp_opt.benchmarks.harness.planners import effort, outcome
from regrasp_opt.benchmarks.harness.runner import Row
from regrasp_opt.errors import OptionError, RegraspError
from regrasp_opt.objects.builtin import OBJECT_NAMES
from regrasp_opt.planning import RegraspProblem, solve_sequence
from regrasp_opt.planning.arm_energy import train_arm_energy
from regrasp_opt.scene import load_workcell


class ForeignArm(NamedTuple):
    """URDF file in the package example-robot-data, tip link, home [rad] and workspace (2, 2) [m] of an arm."""

    urdf: str
    tip: str
    home: tuple[float, ...]
    workspace: tuple[tuple[float, float], tuple[float, float]]


ARMS = {
    "ur5": ForeignArm(
        "ur_description/urdf/ur5_robot.urdf", "tool0", (0, -1.57, 1.57, -1.57, -1.57, 0), ((0.25, 0.6), (-0.35, 0.35))
    ),
    "panda": ForeignArm(
        "panda_description/urdf/panda.urdf",
        "panda_hand_tcp",
        (0, -0.785, 0, -2.356, 0, 1.571, 0.785),
        ((0.3, 0.6), (-0.3, 0.3)),
    ),
    "xarm7": ForeignArm(
        "xarm_description/urdf/xarm7.urdf", "link_eef", (0, -0.5, 0, 0.9, 0, 1.4, 0), ((0.3, 0.55), (-0.3, 0.3))
    ),
}


def write_cell(name: str, folder: Path) -> Path:
    """Write the workcell of the arm `name`, with the gripper ``w`` on a table, to `folder`; return its file.

    Raises
    ------
    OptionError
        If the package that holds the URDF files is not installed.
    """
    arm = ARMS[name]
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError as error:
        raise OptionError("example-robot-data is not installed; install the extra regrasp-opt[robots]") from error
    robots = Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.toml"
    (x, y), home = arm.workspace, list(map(float, arm.home))
    path.write_text(
        f'schema = 1\n[robot]\nmodel = "{(robots / arm.urdf).as_posix()}"\ntip = "{arm.tip}"\nhome = {home}\n'
        '[end_effector]\nmodel = "w"\n[table]\ncenter = [0.2, 0.0]\nsize = [1.4, 1.4]\n'
        f"[workspace]\nx = {list(x)}\ny = {list(y)}\n",
        encoding="utf-8",
    )
    return path


def arm_rows(name: str, folder: Path, pairs: int, time_limit: float, seed: int, jobs: int) -> list[Row]:
    """Return one row about the training of the arm's energy, and one for each of `pairs` plans of each object."""
    cell = load_workcell(write_cell(name, folder))
    path, card = train_arm_energy(cell, out=folder / f"{name}.safetensors", seed=seed, jobs=jobs)
    precision = card["unseen"].values()
    rows: list[Row] = [
        {
            "joints": len(ARMS[name].home),
            "training": sum(card["times"].values()),
            "ap": float(np.mean(list(precision))) if precision else None,
            "least_ap": min(precision, default=None),
        }
    ]
    for number, object_name in enumerate(OBJECT_NAMES):
        problem = RegraspProblem.load(object_name, cell, model=path)
        try:
            instances = random_instances(problem, np.random.default_rng([seed, 7, number]), pairs, object_name)
        except RegraspError as error:
            rows.append({"body": object_name, "reason": str(error)})
            continue
        _ = problem.free_lattice
        for pair in instances:
            plan = solve_sequence(problem, pair.start, pair.goal, seed=seed, time_limit=time_limit)
            rows.append({"body": object_name, "pair": pair.name, **outcome(plan, pair), **effort(plan)})
    return rows
