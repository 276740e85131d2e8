"""``python -m tests.oracles.campaign --out FOLDER``: plans and motions on many arms, verified; damaged plans, checked.

Each trial is a line of FOLDER/trials.jsonl; a run that was ended goes on where it stopped. The tables are written to
FOLDER/campaign.md and printed.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import logging
import multiprocessing
import time
from collections import defaultdict
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from .cells import FOREIGN, OWN, write_cell
from .files import DATA
from .motions import MotionVerifier
from .plans import PlanVerifier

SHARED = Path(__file__).resolve().parents[3] / "shared" / "objects"
BUILT_IN = "bottle", "mug", "pentagon", "figurine"
GRASPS = {"panda": 30, "xarm7": 30}
"""Grasps on arms whose inverse kinematics is slow; 60 elsewhere."""
ROWS = 8
"""Grasps of a transition that are verified, but for every fifth plan, of which all are."""
TIME_LIMIT = 60.0


def groups(plans, motions):
    """Return (cell, object, number of tasks, number of motions); of 640 tasks about 600 are solved."""
    meshes = sorted(SHARED.glob("**/*.stl"))
    chosen = [("nova2-w", name, 80, 6) for name in BUILT_IN]
    chosen += [("nova2-w", str(path), 16, 1) for path in meshes]
    chosen += [("nova2-r140", "mug", 10, 0), ("nova2-s1", "bottle", 10, 1)]
    chosen += [("ur5", name, 12, 2) for name in ("bottle", "mug", "figurine")]
    chosen += [("z1", name, 12, 2) for name in ("pentagon", "mug")]
    chosen += [("panda", "bottle", 12, 2), ("xarm7", "pentagon", 12, 2)]
    chosen += [(name, thing, 12, 2) for name in OWN for thing in ("bottle", "mug")]
    return [(cell, thing, round(n * plans / 600), round(m * motions / 60)) for cell, thing, n, m in chosen]


@cache
def problem_of(cell, thing, folder):
    """Return the problem of an object in a cell; where no energy was prepared, with one that knows nothing."""
    from regrasp_opt import RegraspProblem, load_workcell
    from regrasp_opt.connectivity.embedding import ProblemEnergy
    from regrasp_opt.energy.features import feature_count
    from regrasp_opt.energy.model import EnergyModel
    from regrasp_opt.grasps import sample_grasps
    from regrasp_opt.objects import load_object

    if cell == "nova2-w" and thing in BUILT_IN:
        return RegraspProblem.load(thing, cell), "ipopt"
    body = load_object(thing)
    workcell = load_workcell(write_cell(cell, folder) if cell in {*FOREIGN, *OWN} else cell)
    grasps = sample_grasps(body, workcell.end_effector, GRASPS.get(cell, 60), seed=0)
    problem = replace(RegraspProblem.load(body, workcell, grasps=grasps), model_folder=None)
    zeros = [np.zeros(shape, np.float32) for shape in ((1, feature_count("tcp", False)), (1, 1), (1, 1))]
    biases = tuple(np.zeros(1, np.float32) for _ in zeros)
    nothing = EnergyModel(tuple(zeros), biases, "silu", "tcp", use_width=False, bounded=True, threshold=1.0)
    problem.__dict__["energy"] = ProblemEnergy(nothing, problem.grasps, problem.rests.planar)
    return problem, "lattice"


@cache
def verifier_of(cell, thing, workcell, reference):
    return PlanVerifier({"workcell": json.loads(workcell), "object": json.loads(reference)})


def _name(cell, thing):
    """Return what the files of an object in a cell begin with; a mesh may be called like a built-in object."""
    return f"{cell}-{Path(thing).name.replace('.', '_')}"


def plan_trial(folder, seed, cell, thing, number):
    """Plan between two random poses, verify the plan, and keep it."""
    from regrasp_opt import solve_sequence
    from regrasp_opt.planning.tasks import random_task

    problem, refiner = problem_of(cell, thing, folder)
    rng = np.random.default_rng([seed, number])
    for _ in range(20 if number % 2 else 1):  # every other pair shares no grasp, where such are easily found
        task = random_task(problem, rng, needs_regrasp=False if cell == "z1" and number % 4 != 1 else None)
        if task.shared == 0:
            break
    began = time.perf_counter()
    plan = solve_sequence(
        problem, task.start, task.goal, refiner=refiner, max_regrasps=3, seed=number, time_limit=TIME_LIMIT
    )
    row = {"status": plan.status.name.lower(), "seconds": round(time.perf_counter() - began, 3)}
    if not plan.solved:
        return row
    path = folder / "plans" / f"{_name(cell, thing)}-{number}.json"
    plan.save(path)
    content = json.loads(path.read_text("utf-8"))
    verifier = verifier_of(cell, thing, json.dumps(content["workcell"]), json.dumps(content["object"]))
    picker = np.random.default_rng(number)

    def rows(count):
        return sorted(picker.choice(count, ROWS, replace=False)) if number % 5 and count > ROWS else range(count)

    problems = verifier.problems(content, rows)
    grasps = sum(len(t["grasp_ids"]) for t in content["transitions"])
    return row | {"num_regrasps": plan.num_regrasps, "grasps": grasps, "false": problems[:5], "plan": path.name}


def motion_trial(folder, seed, cell, thing, number):
    """Plan a motion for the first kept plans that have one, and verify it."""
    from regrasp_opt import RegraspPlan
    from regrasp_opt.motion import plan_motion

    kept = sorted(folder.glob(f"plans/{_name(cell, thing)}-*.json"), key=lambda p: int(p.stem.rsplit("-", 1)[1]))
    if not kept:
        return {"status": "no_plan"}
    path = kept[(2 * number + 1) % len(kept)]
    began = time.perf_counter()
    motion = plan_motion(RegraspPlan.load(path))
    row = {"status": motion.status.name.lower(), "seconds": round(time.perf_counter() - began, 3), "plan": path.name}
    if not motion.solved:
        return row | {"reason": motion.reason}
    saved = folder / "motions" / path.name
    motion.save(saved)
    content = json.loads(saved.read_text("utf-8"))
    plan = content["plan"]
    plans = verifier_of(cell, thing, json.dumps(plan["workcell"]), json.dumps(plan["object"]))
    found = MotionVerifier(content, plans).verify(content)
    return row | {"false": found.problems[:5], "samples": found.samples, "velocity": found.velocity}


# ---- damage


def _joint(content, rng):
    t = content["transitions"][rng.integers(len(content["transitions"]))]
    row = t[("q_pick", "q_place")[rng.integers(2)]][rng.integers(len(t["grasp_ids"]))]
    row[rng.integers(len(row))] += 0.01 * rng.choice([-1, 1])


def _width(content, rng):
    ids = content["transitions"][rng.integers(len(content["transitions"]))]["grasp_ids"]
    grasp = content["grasps"][ids[rng.integers(len(ids))]]
    grasp["width"] = max(0.0005, grasp["width"] + 0.007 * rng.choice([-1, 1]))


def _pose(content, rng):
    content["poses"][rng.integers(len(content["poses"]))][rng.integers(3)][3] += 0.004 * rng.choice([-1, 1])


def _grasp(content, rng):
    ids = content["transitions"][rng.integers(len(content["transitions"]))]["grasp_ids"]
    content["grasps"][ids[rng.integers(len(ids))]]["T_object_tcp"][rng.integers(3)][3] += 0.003 * rng.choice([-1, 1])


def _obstacle(content, rng, path):
    """Move an obstacle to a pose of the object in the cell's file; the plan says that it was made for this file."""
    from regrasp_opt import load_workcell

    built_in = content["workcell"]["source"] == "built-in"
    source = Path(content["workcell"]["source"])
    source = DATA / "workcells" / f"{content['workcell']['name']}.toml" if built_in else source
    text = source.read_text("utf-8").split("\n[[obstacles]]")[0]
    T = np.array(content["poses"][rng.integers(len(content["poses"]))])
    place = T[:3, 3] + [0, 0, rng.uniform(0.02, 0.05)]
    size = "size = [0.03, 0.03, 0.03]"
    text += f'\n[[obstacles]]\ntype = "box"\nname = "crate"\nposition = {place.tolist()}\n{size}\n'
    path.write_text(text, encoding="utf-8")
    content["workcell"] |= {"source": str(path), "name": path.stem, "fingerprint": load_workcell(path).fingerprint()}


DAMAGE = {"joint": _joint, "width": _width, "pose": _pose, "grasp": _grasp, "obstacle": _obstacle}


def damage_trial(folder, seed, kind, number):
    """Damage a kept plan in one place; `check` must refuse it, and so must the verifier."""
    from regrasp_opt.cli.app import run

    rng = np.random.default_rng([seed, 7, number])
    kept = sorted(p for p in folder.glob("plans/*.json") if kind != "width" or "-s1-" not in p.name)
    content = json.loads(kept[rng.integers(len(kept))].read_text("utf-8"))
    path = folder / "damaged" / f"{number}-{kind}.json"
    extra = (path.with_suffix(".toml"),) if kind == "obstacle" else ()
    DAMAGE[kind](content, rng, *extra)
    path.write_text(json.dumps(content), encoding="utf-8")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        code = run(["check", str(path)])
    seen = PlanVerifier(content).problems(content)
    return {"status": f"exit {code}", "caught": code != 0, "false": [], "verifier": seen[:2]}


# ---- running


def trial(work):
    folder, seed, what, arguments = work
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # files that a cell names elsewhere
    try:
        found = {"plan": plan_trial, "motion": motion_trial, "damage": damage_trial}[what](folder, seed, *arguments)
    except Exception as error:  # a trial that fails is a finding, too
        found = {"status": f"error: {type(error).__name__}: {error}"[:400]}
    finally:
        logging.disable(before)
    return {"trial": what, "arguments": list(arguments), **found}


def batch(works):
    return [trial(work) for work in works]


def run_campaign(folder, plans, motions, damaged, seed, jobs):
    for name in ("plans", "motions", "damaged"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    log = folder / "trials.jsonl"
    rows = [json.loads(line) for line in log.read_text("utf-8").splitlines()] if log.exists() else []
    rows = [row for row in rows if not row["status"].startswith("error")]  # these are tried again
    done = {(row["trial"], *row["arguments"]) for row in rows}
    chosen, kinds = groups(plans, motions), list(DAMAGE)
    for cell in {cell for cell, *_ in chosen} & {*FOREIGN, *OWN}:
        write_cell(cell, folder)
    parts = [
        [[("plan", (cell, thing, n)) for n in range(first, min(first + 12, count))] for first in range(0, count, 12)]
        for cell, thing, count, _ in chosen
    ]
    stages = [
        [part for group in parts for part in group],
        [[("motion", (cell, thing, n)) for n in range(count)] for cell, thing, _, count in chosen],
        [[("damage", (kinds[n % 5], n)) for n in range(first, damaged, 8)] for first in range(min(8, damaged))],
    ]
    with multiprocessing.get_context("spawn").Pool(jobs) as pool, log.open("a", encoding="utf-8") as file:
        for stage in stages:
            left = [[(folder, seed, what, a) for what, a in part if (what, *a) not in done] for part in stage]
            for found in pool.imap_unordered(batch, [part for part in left if part]):
                for row in found:
                    file.write(json.dumps(row) + "\n")
                    rows.append(row)
                file.flush()
    return rows


def tables(rows):
    """Return the tables of the campaign as markdown."""
    lines = ["# What the verifier says", ""]
    for what in ("plan", "motion"):
        count = defaultdict(lambda: [0, 0, 0])
        for row in rows:
            if row["trial"] == what:
                cell, thing, _ = row["arguments"]
                one = count[cell, Path(thing).stem + Path(thing).suffix]
                one[0] += 1
                one[1] += row["status"] == "solved"
                one[2] += bool(row.get("false"))
        lines += [f"| cell | object | {what}s asked for | solved | false |", "| --- | --- | --- | --- | --- |"]
        lines += [f"| {cell} | {thing} | {a} | {b} | {c} |" for (cell, thing), (a, b, c) in count.items()]
        a, b, c = (sum(one[k] for one in count.values()) for k in range(3))
        lines += [f"| all | | {a} | {b} | {c} |", ""]
    lines += ["| damage | plans | caught by check | seen by the verifier |", "| --- | --- | --- | --- |"]
    for kind in DAMAGE:
        mine = [row for row in rows if row["trial"] == "damage" and row["arguments"][0] == kind]
        caught, seen = (sum(bool(row.get(key)) for row in mine) for key in ("caught", "verifier"))
        lines.append(f"| {kind} | {len(mine)} | {caught} | {seen} |")
    lines.append("")
    for row in rows:
        wrong = row.get("false") or row["status"].startswith("error") or row.get("caught") is False
        if wrong:
            lines.append(f"* {row['trial']} {row['arguments']}: {row['status']} {row.get('false') or ''}")
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    for name, default in (("plans", 600), ("motions", 60), ("damaged", 40), ("seed", 0), ("jobs", 2)):
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    folder = asked.out.resolve()
    rows = run_campaign(folder, asked.plans, asked.motions, asked.damaged, asked.seed, asked.jobs)
    text = tables(rows)
    (folder / "campaign.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
