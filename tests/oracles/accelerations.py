"""``python -m tests.oracles.accelerations --out FOLDER``: motions of several tools, verified: accelerations, durations.

Motions of seeded plans, every fourth among boxes, are verified from their files. With ``--before PATH``, a checkout of
another version, that one plans motions of the same plans, in a process of its own, and durations are compared. Rows are
in FOLDER/rows.json; the exit status is 1 if a motion is wrong, or takes longer than it may.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from .motions import JUMP, MotionVerifier, largest_jump

ROOT = Path(__file__).resolve().parents[2]
CELLS = "nova2-w", "nova2-r85", "nova2-r140", "nova2-s1", "nova2-s3"
OBJECTS = "bottle", "mug", "pentagon", "figurine"
LONGER = 0.03
"""Share by which a motion may take longer than before."""
ATTEMPTS = 10
"""Tasks that are drawn until one is solved."""

MOTIONS = """
import json, sys
from pathlib import Path
from time import process_time
from regrasp_opt import RegraspPlan
from regrasp_opt.motion import plan_motion
folder, rows = Path(sys.argv[1]), {}
for path in sorted(folder.glob("plans/*.json")):
    plan = RegraspPlan.load(path)
    began = process_time()
    motion = plan_motion(plan)
    rows[path.stem] = {"seconds": process_time() - began, "duration": motion.duration, "reason": motion.reason}
    if motion.solved:
        motion.save(folder / sys.argv[2] / path.name)
print(json.dumps(rows))
"""
"""Plans the motions of saved plans with the version that is imported."""


def save_plans(folder, count, seed):
    """Save `count` solved plans between random poses."""
    from regrasp_opt import RegraspProblem, solve_sequence
    from regrasp_opt.errors import RegraspError
    from regrasp_opt.planning.tasks import random_task

    for n in range(count):
        cell, thing = CELLS[n % len(CELLS)], OBJECTS[n // len(CELLS) % len(OBJECTS)]
        rng = np.random.default_rng([seed, n])
        for _ in range(ATTEMPTS):
            problem = RegraspProblem.load(thing, cell)
            if n % 4 == 3:
                problem = problem.with_obstacles([box(rng, number) for number in range(3)])
            try:
                task = random_task(problem, rng)
            except RegraspError:
                continue
            plan = solve_sequence(problem, task.start, task.goal, seed=n, time_limit=20.0)
            if plan.solved:
                plan.save(folder / "plans" / f"{n:03d}-{cell}-{thing}.json")
                break


def box(rng, number):
    """Return a box that stands on the table, away from the robot's base."""
    size, angle, away = rng.uniform(0.04, 0.12, 3), rng.uniform(0.2, np.pi - 0.2), rng.uniform(0.3, 0.6)
    place = [away * np.cos(angle), away * np.sin(angle), size[2] / 2]
    return {"type": "box", "name": f"box{number}", "position": list(map(float, place)), "size": size.tolist()}


def motions_of(version, folder, name):
    """Return what `version`, a checkout, says about the motion of each plan in `folder`."""
    (folder / name).mkdir(exist_ok=True)
    environment = {**os.environ, "PYTHONPATH": str(version)}
    command = [sys.executable, "-c", MOTIONS, str(folder), name]
    done = subprocess.run(command, cwd=version, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def measured(folder, before):
    """Return a row for each plan."""
    found = motions_of(ROOT, folder, "motions")
    earlier = motions_of(before, folder, "before") if before else {}
    rows = []
    for name, row in found.items():
        old = earlier.get(name, {})
        row |= {"plan": name, "duration_before": old.get("duration"), "seconds_before": old.get("seconds")}
        if row["duration"]:
            content = json.loads((folder / "motions" / f"{name}.json").read_text("utf-8"))
            seen = MotionVerifier(content).verify(content)
            row |= {"problems": seen.problems, "jump": seen.jump, "acceleration": seen.acceleration}
        if old.get("duration"):
            row["jump_before"] = largest_jump(json.loads((folder / "before" / f"{name}.json").read_text("utf-8")))
        rows.append(row)
    return rows


def table(rows):
    """Return what the rows say, and whether all is as it should be."""
    moved = [row for row in rows if row["duration"]]
    both = [row for row in moved if row["duration_before"]]
    wrong = [f"{row['plan']}: {text}" for row in moved for text in row["problems"]]
    wrong += [f"{row['plan']}: no motion any more: {row['reason']}" for row in rows if lost(row)]
    lines = [f"plans {len(rows)}, motions {len(moved)}, of them verified {sum(not row['problems'] for row in moved)}"]
    jump = max(row["jump"] for row in moved)
    lines.append(f"largest jump of an acceleration: {jump:.2g} of its limit; allowed {JUMP:g}")
    if both:
        ratios = np.array([row["duration"] / row["duration_before"] for row in both])
        cost = np.median([row["seconds"] / row["seconds_before"] for row in both])
        jumps = max(row["jump_before"] for row in both)
        lines.append(f"before: motions {sum(bool(row['duration_before']) for row in rows)}, largest jump {jumps:.2g}")
        lines.append(f"duration now / before: median {np.median(ratios):.4f}, {ratios.min():.4f} to {ratios.max():.4f}")
        lines.append(f"planning time now / before: median {cost:.2f}")
        wrong += [f"{r['plan']}: takes {x:.4f} as long" for r, x in zip(both, ratios, strict=True) if x > 1 + LONGER]
    return "\n".join(lines + wrong), not wrong


def lost(row):
    return not row["duration"] and bool(row["duration_before"])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--plans", type=int, default=44)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    folder = asked.out.resolve()
    (folder / "plans").mkdir(parents=True, exist_ok=True)
    save_plans(folder, asked.plans, asked.seed)
    rows = measured(folder, asked.before and asked.before.resolve())
    (folder / "rows.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    text, well = table(rows)
    print(text)
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
