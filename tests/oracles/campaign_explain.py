"""``python -m tests.oracles.campaign_explain --out FOLDER``: tasks without a plan, of known cause, explained.

Each task is made so that one thing, known beforehand, is to blame. The explanation must name it first. Then its advice
is followed, the first of two kinds (in every fifth task of all kinds), as somebody would who knows nothing but the
explanation, and the plan that results is verified by `PlanVerifier`. Each task is a line of FOLDER/explain.jsonl; a run
that was ended goes on where it stopped. Tables are printed and written to FOLDER/explain.md.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections import defaultdict
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from .files import DATA
from .plans import PlanVerifier

BUILT_IN = "bottle", "mug", "pentagon", "figurine"
CELL = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
URDF = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8")
GRASPS = 200
ROWS = 8
"""Grasps of a transition that are verified."""


@dataclass
class Task:
    """A task without a plan: files, poses, what was put in the way, and what the explanation must begin with."""

    thing: str
    cell: Path
    start: Any = None
    goal: Any = None
    obstacles: list[dict[str, Any]] = field(default_factory=list)
    most: int = 5
    keep: int = GRASPS
    named: str = ""

    def problem(self, without=(), grasps=None, end_effector=None):
        """Return the problem, with the changes of a remedy."""
        from regrasp_opt import RegraspProblem, load_object, load_workcell
        from regrasp_opt.grasps import sample_grasps

        body, cell = load_object(self.thing), load_workcell(self.cell, end_effector=end_effector)
        if grasps is None and end_effector is None and self.keep < GRASPS:
            given = RegraspProblem.load(body, cell).grasps.subset(range(0, GRASPS, GRASPS // self.keep))
        else:
            given = grasps and sample_grasps(body, cell.end_effector, grasps["count"], seed=grasps["seed"])
        left = [each for each in self.obstacles if each["name"] not in without]
        return RegraspProblem.load(body, cell, grasps=given).with_obstacles(left)


def _cell(folder, name, text=CELL):
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _graspable(problem, rng):
    """Return a random pose with feasible grasps, and these."""
    from regrasp_opt.planning.tasks import random_graspable_pose

    T = random_graspable_pose(problem, rng)
    return T, problem.feasible_grasps(T)


def out_of_reach(folder, rng, number):
    """An object so far away that no grasp's TCP can be reached; every other one is refused outright."""
    wide = CELL.replace("size = [1.4, 1.2]", "size = [6.0, 6.0]")
    wide = wide.replace("x = [-0.45, 0.45]", "x = [-2.5, 2.5]").replace("y = [0.1, 0.6]", "y = [-2.5, 2.5]")
    thing = BUILT_IN[number % 4]
    cell = _cell(folder, f"reach{number}", wide)
    task = Task(thing, cell, named="out of reach")
    problem = task.problem()
    near = Task(thing, _cell(folder, "near")).problem()
    task.goal = _graspable(near, rng)[0]
    robot = problem.workcell.robot
    reach = robot.max_reach + problem.workcell.end_effector.tcp_offset
    for _ in count():
        angle, far = rng.uniform(0, 2 * np.pi), reach + rng.uniform(0.0, 0.35)
        T = problem.pose(int(rng.integers(len(problem.placements))), far * np.cos(angle), far * np.sin(angle), angle)
        tcp = (T @ problem.grasps.T_object_tcp)[:, :3, 3]
        touched = np.linalg.norm(problem.object.vertices @ T[:3, :3].T + T[:3, 3], axis=1).min() <= reach
        if np.linalg.norm(tcp, axis=1).min() > reach + 0.001 and touched == bool(number % 2):
            task.start = T
            return task


def blocked(folder, rng, number):
    """A box that blocks every grasp of the start, and two that block none; the object itself is clear of all."""
    from regrasp_opt import RegraspError

    task = Task(BUILT_IN[number % 4], _cell(folder, "nova2"))
    problem = task.problem()
    name = ("crate", "lamp", "wall", "press", "shelf")[number % 5]
    others = [
        {"type": "box", "name": f"other{k}", "position": [side * 0.55, 0.75, 0.1], "size": [0.1, 0.1, 0.2]}
        for k, side in enumerate((-1, 1))
    ]
    easy = problem.with_obstacles(others)
    task.goal = _graspable(easy, rng)[0]
    for _ in count():
        start = _graspable(easy, rng)[0]
        points = problem.object.vertices @ start[:3, :3].T + start[:3, 3]
        size = rng.uniform([0.1, 0.1, 0.01], [0.3, 0.3, 0.1])
        place = [
            *rng.normal(points.mean(axis=0)[:2], 0.03),
            points[:, 2].max() + size[2] / 2 + rng.uniform(0.004, 0.03),
        ]
        box = {"type": "box", "name": name, "position": [float(x) for x in place], "size": size.tolist()}
        try:
            hard = easy.with_obstacles([box])
        except RegraspError:  # the box is in the arm's way at home
            continue
        clear = hard.checker.object_problem(start) is None and hard.checker.object_problem(task.goal) is None
        if clear and not hard.feasible_grasps(start).any():
            task.start, task.obstacles, task.named = start, [*others, box], f"'{name}'"
            return task


def too_wide(folder, rng, number):
    """A block wider than the jaw on all sides, or a plate that lies flat and fits the jaw across its thickness only."""
    flat = number % 2
    size = rng.uniform(0.105, 0.125, 3)
    size[2] = rng.uniform(0.03, 0.04) if flat else size[2] + 0.03
    path = folder / f"wide{number}.stl"
    trimesh.creation.box(size).export(path)
    task = Task(str(path), _cell(folder, "nova2"), named="too wide")
    if flat:
        problem = task.problem()
        lying = [k for k, p in enumerate(problem.placement_poses) if abs(p[2, 2]) > 0.9]
        standing = [k for k in range(len(problem.placements)) if k not in lying]
        while True:
            task.start = problem.pose(lying[0], rng.uniform(-0.25, 0.25), rng.uniform(0.3, 0.4), rng.uniform(0, 6))
            xi = rng.uniform(-0.3, 0.3), rng.uniform(0.25, 0.45), rng.uniform(0, 6)
            task.goal = problem.pose(int(rng.choice(standing)), *xi)
            if problem.feasible_grasps(task.goal).any():
                break
    return task


def not_shared(folder, rng, number):
    """Ends without a common grasp: no regrasp is allowed, or so few grasps are given that no poses help."""
    from regrasp_opt import solve_sequence

    task = Task(BUILT_IN[number % 4], _cell(folder, "nova2"), named="no shared grasp")
    task.most, task.keep = (0, GRASPS) if number % 2 else (1, 4)
    problem = task.problem()
    for _ in count():
        (task.start, first), (task.goal, last) = _graspable(problem, rng), _graspable(problem, rng)
        if not (first & last).any() and (
            task.most == 0 or not solve_sequence(problem, task.start, task.goal, "exact", max_regrasps=task.most).solved
        ):
            return task


def table(folder, rng, number):
    """A thin sheet on the table, narrow enough for the jaw: fingertips beside it would be in the table."""
    path = folder / f"sheet{number}.stl"
    sheet = trimesh.creation.cylinder(rng.uniform(0.03, 0.04), 0.003, sections=48)
    if number % 2:
        sheet = trimesh.creation.box([*rng.uniform(0.05, 0.08, 2), rng.uniform(0.002, 0.003)])
    sheet.export(path)
    task = Task(str(path), _cell(folder, "nova2"), named="in table")
    problem = task.problem()
    poses = [problem.pose(0, x, rng.uniform(0.25, 0.4), rng.uniform(0, 6)) for x in rng.uniform(-0.3, 0.3, 2)]
    task.start, task.goal = poses
    return task


def limits(folder, rng, number):
    """An arm with one joint that turns less far: what would reach the start is beyond the limits of that joint."""
    task = Task(BUILT_IN[number % 4], _cell(folder, "nova2"))
    problem = task.problem()
    home = problem.workcell.robot.home
    urdf = folder / f"limits{number}.urdf"
    for _ in count():
        (start, _), (goal, _) = _graspable(problem, rng), _graspable(problem, rng)
        joint = int(rng.integers(6))
        low = home[joint] - rng.uniform(0.1, 1.0)
        high = home[joint] + rng.uniform(0.1, 1.0)
        solutions = problem.checker.configurations(start, np.flatnonzero(problem.feasible_grasps(start)))
        q = np.concatenate(solutions)[:, joint]
        turned = q[:, None] + 2 * np.pi * np.arange(-1, 2)
        if ((turned > low - 0.01) & (turned < high + 0.01)).any():
            continue
        urdf.write_text(_narrowed(joint, low, high), encoding="utf-8")
        text = CELL.replace('model = "nova2"', f'model = "{urdf.name}"\nhome = {home.tolist()}')
        task.cell = _cell(folder, f"limits{number}", text)
        task.start, task.goal, task.named = start, goal, f"joint limit of 'joint{joint + 1}'"
        if task.problem().feasible_grasps(goal).any():
            return task


def _narrowed(joint, low, high):
    parts = re.split(r'(lower="[^"]*" upper="[^"]*")', URDF)
    parts[2 * joint + 1] = f'lower="{low:.4f}" upper="{high:.4f}"'
    return "".join(parts)


KINDS = {each.__name__: each for each in (out_of_reach, blocked, too_wide, not_shared, table, limits)}


def explained(task, time_limit=60.0):
    """Return what is named first, and the remedies that help as (change, value), in the order of the explanation."""
    from regrasp_opt import solve_sequence
    from regrasp_opt.errors import GraspError, PoseError

    try:
        problem = task.problem()
    except GraspError as error:  # the message is all there is
        tools = re.search(r"opens wider \(([^)]*)\)", str(error))
        names = tools[1].split(", ") if tools else ["s1"] if "suction cup" in str(error) else []
        return re.search(r"it is ([^:]*):", str(error))[1], str(error), [("tool", {"end_effector": n}) for n in names]
    try:
        plan = solve_sequence(problem, task.start, task.goal, "exact", max_regrasps=task.most)
    except PoseError:
        explanation = problem.explain(task.start, time_limit=time_limit)
    else:
        assert not plan.solved
        explanation = plan.explain(time_limit=time_limit)
    advice = [(r.change.name.lower(), {**r.value, "num_regrasps": r.num_regrasps}) for r in explanation.helpful]
    return str(explanation.causes[0]), str(explanation), advice


def followed(task, value, path):
    """Return the status of the plan after a change, the `value` of a remedy, and what the verifier says of it."""
    from regrasp_opt import solve_sequence

    grasps = {"count": value["grasps"], "seed": value["seed"]} if "grasps" in value else None
    problem = task.problem(value.get("without", ()), grasps, value.get("end_effector"))
    start, goal = (value.get("pose", value.get("start", task.start)), value.get("goal", task.goal))
    if start is None:  # nothing could be asked before: any two poses
        rng = np.random.default_rng(0)
        start, goal = (_graspable(problem, rng)[0] for _ in range(2))
    most = max(value.get("max_regrasps", task.most), value.get("num_regrasps") or 0)
    plan = solve_sequence(problem, start, goal, "exact", max_regrasps=most)
    if not plan.solved:
        return plan.status.name.lower(), []
    plan.save(path)
    content = json.loads(path.read_text("utf-8"))
    picker = np.random.default_rng(0)
    chosen = lambda found: sorted(picker.choice(found, min(found, ROWS), replace=False))  # noqa: E731
    return "solved", PlanVerifier(content).problems(content, chosen)[:3]


def trial(folder, seed, kind, number):
    """Make a task, have it explained, and follow the advice, first things first."""
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    task = KINDS[kind](folder, rng, number)
    began = time.process_time()
    named, text, advice = explained(task)
    row = {"kind": kind, "number": number, "truth": task.named, "named": named, "text": text}
    row |= {"right": task.named in named, "seconds": round(time.process_time() - began, 2), "tried": []}
    by_kind = dict[str, Any]()
    for change, value in advice:
        by_kind.setdefault(change, value)
    for change, value in list(by_kind.items())[: None if number % 5 == 0 else 2]:
        status, false = followed(task, value, folder / f"{kind}-{number}-{change}.json")
        row["tried"].append({"change": change, "status": status, "false": false})
    return row


def tables(rows):
    """Return the table of the campaign as markdown."""
    lines = [
        "| cause | tasks | named right | with advice | first advice solves | advice that leaves obstacles solves |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    sums = np.zeros(5, dtype=int)
    by_kind = defaultdict(list)
    for row in rows:
        by_kind[row["kind"]].append(row)
    for kind, mine in by_kind.items():
        tried = [row["tried"] for row in mine]
        values = [
            len(mine),
            sum(row["right"] for row in mine),
            sum(map(bool, tried)),
            sum(bool(each) and each[0]["status"] == "solved" for each in tried),
            sum(any(one["status"] == "solved" and one["change"] != "obstacle" for one in each) for each in tried),
        ]
        sums += values
        lines.append(f"| {kind.replace('_', ' ')} | {' | '.join(map(str, values))} |")
    lines += [f"| all | {' | '.join(map(str, sums.tolist()))} |", ""]
    lines += ["| advice | given | solves when followed | false plans |", "| --- | --- | --- | --- |"]
    all_tried = [one for row in rows for one in row["tried"]]
    for change in dict.fromkeys(one["change"] for one in all_tried):
        given = [one for one in all_tried if one["change"] == change]
        solved, false = sum(one["status"] == "solved" for one in given), sum(bool(one["false"]) for one in given)
        lines.append(f"| {change} | {len(given)} | {solved} | {false} |")
    lines.append("")
    lines += [
        f"* {row['kind']} {row['number']}: {row['truth']!r}, but {row['named']!r}" for row in rows if not row["right"]
    ]
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tasks", type=int, default=10, help="tasks of each cause")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS))
    asked = parser.parse_args()
    folder = asked.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "explain.jsonl"
    rows = [json.loads(line) for line in kept.read_text("utf-8").splitlines()] if kept.exists() else []
    done = {(row["kind"], row["number"]) for row in rows}
    with kept.open("a", encoding="utf-8") as log:
        for kind in asked.kinds:
            for number in (n for n in range(asked.tasks) if (kind, n) not in done):
                rows.append(trial(folder, asked.seed, kind, number))
                log.write(json.dumps(rows[-1]) + "\n")
                log.flush()
                print(kind, number, rows[-1]["right"], rows[-1]["named"], rows[-1]["tried"], rows[-1]["seconds"])
    text = tables(rows)
    (folder / "explain.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
