"""A motion in a simulator with contacts and friction: does the object arrive where the plan has it?

MuJoCo gets a model of the cell and what its actuators are told, as `regrasp-opt motion --mjcf FOLDER` writes them. The
replay reads these files alone. Whenever the object has been put down, it prints how far it lies from the pose of the
plan: `python examples/09_replay_in_mujoco.py [OBJECT] [SPEED]`, by default a bottle at a quarter of the speed. It needs
`pip install regrasp-opt[mujoco]`.
"""

import csv
import sys
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from regrasp_opt import RegraspProblem
from regrasp_opt.io.mjcf_export import save_mjcf
from regrasp_opt.motion import plan_with_motion
from regrasp_opt.planning.tasks import random_task

SETTLE = 0.5
"""How long to wait at the end [s]."""


class Placed(NamedTuple):
    """How far the object lies from a pose of the plan."""

    number: int
    offset: float
    angle: float


def write(name: str, folder: Path) -> None:
    """Plan a task with a regrasp for the object `name`, and write its motion to `folder`."""
    problem = RegraspProblem.load(name, "nova2-w")
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    motion = plan_with_motion(problem, task.start, task.goal)
    assert motion.solved, motion.reason
    save_mjcf(motion, folder)


def replay(folder: Path, speed: float) -> list[Placed]:
    """Return where the object lies after each transition of the motion in `folder`, carried out at `speed`."""
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    with (folder / "trajectory.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    times = np.array([float(row["time"]) for row in rows]) / speed
    names = [model.actuator(number).name for number in range(model.nu)]
    controls = np.array([[float(row[name]) for name in names] for row in rows])
    grasps = [k for k, row in enumerate(rows) if row["phase"] == "grasp" != rows[k - 1]["phase"]]
    looks = [*times[grasps[1:]].tolist(), times[-1] + SETTLE]  # just before the next grasp, and at the end

    placed = list[Placed]()
    while len(placed) < len(looks):
        data.ctrl[:] = [np.interp(data.time, times, column) for column in controls.T]
        mujoco.mj_step(model, data)
        if data.time >= looks[len(placed)]:
            placed.append(_compare(model, data, len(placed) + 1))
    return placed


def _compare(model: mujoco.MjModel, data: mujoco.MjData, number: int) -> Placed:
    body, site = data.body("object"), data.site(f"pose{number}")
    turn = body.xmat.reshape(3, 3) @ site.xmat.reshape(3, 3).T
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    return Placed(number, float(np.linalg.norm(body.xpos - site.xpos)), float(angle))


def main(name: str = "bottle", speed: str = "0.25") -> None:
    """Write and replay one motion."""
    folder = Path(f"{Path(name).stem}-mujoco")
    write(name, folder)
    for number, offset, angle in replay(folder, float(speed)):
        print(f"pose {number}: the {Path(name).stem} lies {1e3 * offset:.1f} mm and {np.degrees(angle):.1f} deg away")


if __name__ == "__main__":
    main(*sys.argv[1:])
