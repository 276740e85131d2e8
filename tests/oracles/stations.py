"""``python -m tests.oracles.stations --out FOLDER``: plans and motions between two tables and a shelf, verified.

Each task begins and ends on different supports; beside it an exact search says what can be solved, and a task on a
single table, which needs a regrasp where this one does, what time is usual. Rows are in FOLDER/stations.jsonl, a run
that was ended goes on where it stopped; the tables are written to FOLDER/stations.md and printed.
"""

from __future__ import annotations

import argparse
import json
import time
from functools import cache
from pathlib import Path

import numpy as np

from .campaign import SHARED
from .campaign import verifier_of as verifier_with
from .motions import MotionVerifier

SCENES = Path(__file__).resolve().parents[2] / "docs" / "scenes"
CAN, BOX = SHARED / "ycb" / "pottedmeatcan.stl", SHARED / "ycb" / "crackerbox.stl"
GROUPS = (
    ("w", "bottle", 0.25),
    ("w", "mug", 0.25),
    ("w", str(SHARED / "bunny.stl"), 0.2),
    ("w", str(CAN), 0.2),
    ("r140", str(BOX), 0.1),
)
"""Tool, object, and its share of the tasks."""
SHOWN = json.loads((SCENES / "tasks.json").read_text("utf-8"))
"""Scenes in files of the same name: object, start and goal."""
LONGEST = 3
ROWS = 8
"""Grasps of a transition that are verified, but for every fifth plan, of which all are."""


@cache
def problem_of(tool, thing, cell):
    from regrasp_opt import RegraspProblem, solve_sequence

    problem = RegraspProblem.load(thing, SCENES / f"{cell}.toml", end_effector=tool)
    start, goal = random_ends(problem, np.random.default_rng(0), needs_regrasp=True)
    solve_sequence(problem, start, goal)  # what is made once, and not timed
    return problem


@cache
def resting_poses(tool, thing, cell, count, seed):
    from regrasp_opt.planning.exact import RestingPoses

    problem = problem_of(tool, thing, cell)
    poses = RestingPoses(problem.checker, problem.rests.planar, np.random.default_rng(seed))
    poses.grow(count)
    return poses


def random_ends(problem, rng, needs_regrasp=None):
    """Return start and goal (4, 4), on different supports where there are several."""
    from regrasp_opt.planning.tasks import random_task

    while True:
        start, goal, _ = random_task(problem, rng, needs_regrasp=needs_regrasp)
        on = {problem.station(T).support for T in (start, goal)}
        if len(on) == min(2, len(problem.workcell.supports)):
            return start, goal


def fewest(problem, poses, start, goal):
    """Return the number of regrasps that an exact search needs, or None."""
    ends = [problem.feasible_grasps(T) for T in (start, goal)]
    if (ends[0] & ends[1]).any():
        return 0
    path = next(iter(poses.shortest_paths(*ends, range(1, LONGEST + 1))), None)
    return None if path is None else len(path.placements)


def timed_plan(problem, start, goal, seed):
    from regrasp_opt import solve_sequence

    began = time.process_time()
    plan = solve_sequence(problem, start, goal, seed=seed, max_regrasps=LONGEST)
    return plan, {
        "status": plan.status.name.lower(),
        "num_regrasps": plan.num_regrasps if plan.solved else None,
        "seconds": round(time.process_time() - began, 4),
    }


def verifier_of(content):
    return verifier_with(None, None, json.dumps(content["workcell"]), json.dumps(content["object"]))


def verified(plan, path, seed):
    """Return what is wrong with a plan, read from the file that it is saved to."""
    plan.save(path)
    content, picker = json.loads(path.read_text("utf-8")), np.random.default_rng(seed)

    def rows(count):
        return sorted(picker.choice(count, ROWS, replace=False)) if seed % 5 and count > ROWS else range(count)

    return verifier_of(content).problems(content, rows)[:5]


def timed_motion(plan, path=None):
    """Return what came of the motion of a plan, and what is wrong with it, read from the file that it is saved to.

    Without a path it is not verified.
    """
    from regrasp_opt.motion import plan_motion

    began = time.process_time()
    motion = plan_motion(plan)
    row = {"status": motion.status.name.lower(), "seconds": round(time.process_time() - began, 4)}
    if not motion.solved:
        return row | {"reason": motion.reason}
    if path is None:
        return row
    motion.save(path)
    content = json.loads(path.read_text("utf-8"))
    return row | {"false": MotionVerifier(content, verifier_of(content["plan"])).verify(content).problems[:5]}


def task(folder, seed, count, tool, thing, number, with_motion):
    """Return the row of one task in the shelf's cell, and of one on the table."""
    name, row, needs_regrasp = f"{tool}-{Path(thing).stem}-{number}", {}, None
    for cell in ("shelf", "table"):
        problem = problem_of(tool, thing, cell)
        start, goal = random_ends(problem, np.random.default_rng([seed, number]), needs_regrasp)
        plan, found = timed_plan(problem, start, goal, number)
        found["supports"] = [station.support for station in plan.stations] if plan.solved else []
        if cell == "shelf":
            found["exact"] = fewest(problem, resting_poses(tool, thing, cell, count, seed), start, goal)
            needs_regrasp = found["exact"] != 0
            found["ends"] = [problem.station(T).support for T in (start, goal)]
            if plan.solved:
                found["false"] = verified(plan, folder / "plans" / f"{name}.json", number)
        if with_motion and plan.solved:
            found["motion"] = timed_motion(plan, folder / "motions" / f"{name}.json" if cell == "shelf" else None)
        row[cell] = found
    return row


def scene(folder, name):
    """Return the row of a scene that is shown: planned, verified and moved."""
    from regrasp_opt import RegraspProblem
    from regrasp_opt.planning.pose_text import parse_pose

    thing, *ends = SHOWN[name]
    problem = RegraspProblem.load(thing, SCENES / f"{name}.toml")
    plan, found = timed_plan(problem, *(parse_pose(text, "end", problem) for text in ends), 0)
    if plan.solved:
        found["supports"] = [station.support for station in plan.stations]
        found["false"] = verified(plan, folder / "plans" / f"{name}.json", 0)
        found["motion"] = timed_motion(plan, folder / "motions" / f"{name}.json")
    return {"scene": name, **found}


def run(folder, tasks, motions, count, seed):
    """Return the rows of all scenes and tasks; those that are not in the folder yet are made."""
    for name in ("plans", "motions"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    log = folder / "stations.jsonl"
    rows = [json.loads(line) for line in log.read_text("utf-8").splitlines()] if log.exists() else []
    done = {row.get("scene") or (row["tool"], row["object"], row["number"]) for row in rows}
    with log.open("a", encoding="utf-8") as file:

        def add(row):
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()

        for name in SHOWN:
            if name not in done:
                add(scene(folder, name))
        numbers = [(tool, thing, share, n) for tool, thing, share in GROUPS for n in range(round(share * tasks))]
        for tool, thing, share, number in sorted(numbers, key=lambda one: one[3] / one[2]):  # all advance together
            if (tool, Path(thing).name, number) not in done:
                row = task(folder, seed, count, tool, thing, number, number < round(share * motions))
                add({"tool": tool, "object": Path(thing).name, "number": number, **row})
    return rows


def tables(rows):
    """Return the tables as markdown."""
    scenes, tasks = [row for row in rows if "scene" in row], [row for row in rows if "tool" in row]
    lines = ["| scene | on the way | plan | false | motion | false |", "| --- | --- | --- | --- | --- | --- |"]
    for row in scenes:
        motion = row.get("motion", {})
        way = ", ".join(row.get("supports", ()))
        verdicts = len(row.get("false", ())), motion.get("status", "none"), len(motion.get("false", ()))
        lines.append(f"| {row['scene']} | {way} | {row['status']} | {' | '.join(map(str, verdicts))} |")
    lines += ["", f"| object | tasks | exact | solved of these | N equal | fewer | more | false | {TIMES} |"]
    lines += ["| --- " * 10 + "|"]
    groups = list(dict.fromkeys((row["tool"], row["object"]) for row in tasks))
    lines += [_plans(f"{thing}, {tool}", [r for r in tasks if (r["tool"], r["object"]) == (tool, thing)])
              for tool, thing in groups]  # fmt: skip
    lines += [_plans("all", tasks), "", f"| cell | motions | solved | false | {MOTION_TIMES} |", "| --- " * 6 + "|"]
    for cell in ("shelf", "table"):
        found = [row[cell]["motion"] for row in tasks if "motion" in row[cell]]
        solved = [motion for motion in found if motion["status"] == "solved"]
        false, seconds = sum(bool(m.get("false")) for m in solved), [m["seconds"] for m in solved]
        lines.append(
            f"| {cell} | {len(found)} | {len(solved)} | {false} | {_middle(seconds)} | {_middle(seconds, 90)} |"
        )
    lines.append("")
    for row in rows:
        for found in (row, row.get("shelf", {}), row.get("table", {})):
            wrong = [*found.get("false", ()), *found.get("motion", {}).get("false", ())]
            missed = found.get("exact") is not None and found["num_regrasps"] != found["exact"]
            failed = found.get("motion", {}).get("reason")
            if wrong or missed or failed:
                lines.append(f"* {row.get('scene') or (row['tool'], row['object'], row['number'])}: {found}")
    return "\n".join(lines) + "\n"


TIMES = "median [s] | on the table [s]"
MOTION_TIMES = "median [s] | 90 % [s]"


def _plans(name, rows):
    found = [row["shelf"] for row in rows]
    exact = [f for f in found if f["exact"] is not None]
    solved = [f for f in exact if f["status"] == "solved"]
    n = [np.sign(f["num_regrasps"] - f["exact"]) for f in solved]
    counts = [n.count(sign) for sign in (0, -1, 1)]
    false, table = sum(bool(f.get("false")) for f in found), [row["table"]["seconds"] for row in rows]
    cells = [name, len(rows), len(exact), len(solved), *counts, false, _middle([f["seconds"] for f in found])]
    return "| " + " | ".join(map(str, [*cells, _middle(table)])) + " |"


def _middle(values, share=50):
    return f"{np.percentile(values, share):.3f}" if values else ""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    for name, default in (("tasks", 200), ("motions", 60), ("poses", 3000), ("seed", 0)):
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    folder = asked.out.resolve()
    text = tables(run(folder, asked.tasks, asked.motions, asked.poses, asked.seed))
    (folder / "stations.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
