"""Other arms than the one whose energies come along: their kinematics, training, plans and motions."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from regrasp_opt.benchmarks.comparisons.any import solvable_pairs
from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.planners import effort, outcome, warm_up
from regrasp_opt.benchmarks.harness.report import Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.conventions import planar_transform
from regrasp_opt.feasibility.dataset import random_poses
from regrasp_opt.files import content_hash
from regrasp_opt.motion import MotionOptions, plan_motion, plan_with_motion
from regrasp_opt.planning import RegraspProblem, solve_sequence
from regrasp_opt.planning.arm_energy import train_arm_energy
from regrasp_opt.planning.recipes import RECIPES
from regrasp_opt.scene import FURTHER_WORKCELL_NAMES, load_workcell

TEXT = (
    "The built-in workcells with other arms than the Nova2, whose energies do not come along. Each energy is trained "
    "here, by one process, without any object, and plans for the built-in objects. A pair of poses counts if a search "
    "over exactly checked random resting poses (`truth` of them) solves it; the N of the pair is the least that these "
    "allow. Only such pairs are planned for; they share no grasp, unless an object has too few such pairs. Training "
    "and checks are in processor time of one process, plans and motions by the clock in a warm process, whatever else "
    "the machine does."
)


@dataclass(frozen=True)
class ArmSizes:
    """How much is measured: `pairs` of each object, out of a pool of `pool` poses, and tool `poses` to train on.

    `truth` random poses are checked exactly to say which pairs have a plan; `checks` pose-grasp pairs are timed. A plan
    is given up after `time_limit` seconds.
    """

    cells: tuple[str, ...]
    pairs: int
    truth: int
    pool: int
    checks: int
    time_limit: float
    poses: int | None = None


QUICK = ArmSizes(("iiwa7-w",), pairs=1, truth=200, pool=40, checks=2000, time_limit=10.0, poses=24_000)
FULL = ArmSizes(FURTHER_WORKCELL_NAMES, pairs=10, truth=1000, pool=100, checks=40_000, time_limit=30.0)

CONFIGURATIONS = 300
"""Random configurations at whose poses branches are counted."""


def run_arms(session: Session) -> Report:
    """Train for the built-in workcells with other arms, and plan in them."""
    sizes = QUICK if session.quick else FULL
    results = [session.execute("arms", list(items)) for items in (_trained(session, sizes), _planned(session, sizes))]
    rows = [row for result in results for row in result.rows]
    return Report(
        "arms",
        "Other arms",
        TEXT,
        tuple(arm_tables(rows)),
        rows,
        revisions=tuple(sorted({name for result in results for name in result.revisions})),
        settings={"quick": session.quick, "seed": session.seed, **asdict(sizes)},
    )


def _trained(session: Session, sizes: ArmSizes) -> Iterator[Item]:
    for cell in sizes.cells:
        function = partial(arm_row, cell, _energy_file(session, cell), sizes, session.seed)
        yield Item(cell, content_hash(asdict(sizes), session.seed), function, (), {"workcell": cell})


def _planned(session: Session, sizes: ArmSizes) -> Iterator[Item]:
    for cell in sizes.cells:
        for name in session.names:
            function = partial(pair_rows, cell, name, _energy_file(session, cell), sizes, replace(session, jobs=1))
            depends = content_hash(asdict(sizes), session.seed, name)
            yield Item(f"{cell}/{name}", depends, function, (), {"workcell": cell, "object": name})


def _energy_file(session: Session, cell: str) -> Path:
    return session.folder / "arms" / "energies" / f"{cell}.safetensors"


def arm_row(cell: str, path: Path, sizes: ArmSizes, seed: int) -> list[Row]:
    """Train the energy of the arm in a workcell, keep it in `path`, and return the one row about the arm."""
    workcell = load_workcell(cell)
    robot, began = workcell.robot, time.process_time()
    _, card = train_arm_energy(workcell, poses=sizes.poses, out=path, seed=seed, jobs=1)
    training = time.process_time() - began
    rng = np.random.default_rng([seed, 1])
    q = rng.uniform(robot.lower, robot.upper, (CONFIGURATIONS, robot.dof))
    found = len(robot.solve_ik(robot.forward(q)).q)
    problem = RegraspProblem.load("bottle", workcell, model=path)
    numbers, xi = random_poses(
        problem.placement_poses, workcell.bounds.array, -(-sizes.checks // len(problem.grasps)), rng
    )
    T = planar_transform(xi) @ problem.placement_poses[numbers]
    problem.checker.feasible(T[0])  # whatever is made when it is first needed
    checking = time.process_time()
    for pose in T:
        problem.checker.feasible(pose)
    rate = len(T) * len(problem.grasps) / (time.process_time() - checking)
    precision = list(card["unseen"].values())
    return [
        {
            "robot": robot.name,
            "tool": workcell.end_effector.name,
            "joints": robot.dof,
            "solver": robot.ik_test.solver,
            "branches": found / CONFIGURATIONS,
            "checks": rate,
            "poses": card["poses"],
            "training": training,
            "ap": float(np.mean(precision)) if precision else None,
            "least_ap": min(precision, default=None),
        }
    ]


def pair_rows(cell: str, name: str, path: Path, sizes: ArmSizes, session: Session) -> list[Row]:
    """Return a row for each pair of poses of the object `name`: its plan, and the motion of it.

    Raises
    ------
    GraspError
        If no pair can be planned; says why.
    """
    problem = RegraspProblem.load(name, load_workcell(cell), model=path)
    pairs, _ = solvable_pairs(problem, sizes.pairs, sizes.truth, sizes.pool, session, f"{cell}/{name}")
    recipe, rows = RECIPES["ipopt"](), list[Row]()
    for pair in pairs:
        warm_up(problem, pair, recipe)
        processor = time.process_time()
        plan = solve_sequence(problem, pair.start, pair.goal, recipe, seed=session.seed, time_limit=sizes.time_limit)
        row: Row = {"pair": pair.name, "processor": time.process_time() - processor, **outcome(plan, pair)}
        row |= effort(plan)
        if plan.solved:
            options, began = MotionOptions(seed=session.seed), time.perf_counter()
            motion = plan_motion(plan, options)
            row |= {"first_moves": motion.solved, "reason": motion.reason}
            if not motion.solved:
                limit = {"seed": session.seed, "time_limit": sizes.time_limit}
                motion = plan_with_motion(problem, pair.start, pair.goal, options=options, **limit)
            row |= {"moves": motion.solved, "motion_seconds": time.perf_counter() - began}
        rows.append(row)
    return rows


def arm_tables(rows: list[Row]) -> list[Table]:
    """Return the tables of the rows of `run_arms`."""
    trained = [row for row in rows if "training" in row]

    def rounded(key: str, digits: int | None) -> tables.Value:
        return lambda row: None if row[key] is None else round(row[key], digits)

    arms: dict[str, tables.Value] = {
        "workcell": "workcell",
        "joints": "joints",
        "inverse kinematics": "solver",
        "branches": rounded("branches", 1),
        "checks a second": lambda row: int(round(row["checks"], -2)),
        "training, processor [s]": rounded("training", 0),
        "AP, unseen objects": rounded("ap", 4),
        "least AP": rounded("least_ap", 4),
    }
    plans = [row for row in rows if "pair" in row]
    columns: dict[str, tables.Column] = {
        "pairs": len,
        "solved [%]": tables.share("solved"),
        "N no larger [%]": tables.share(lambda row: row["num_regrasps"] <= row["minimum"], of="solved"),
        "median [s]": tables.middle("seconds", of="solved"),
        "p95 [s]": tables.late("seconds", of="solved"),
        "median, processor [s]": tables.middle("processor", of="solved"),
        "first moves [%]": tables.share("first_moves", of="solved"),
        "moves [%]": tables.share("moves", of="solved"),
        "motion [s]": tables.middle("motion_seconds", of="moves"),
    }
    missed: dict[str, tables.Value] = {
        "pair": "pair",
        "plan": "status",
        "N": "num_regrasps",
        "least N": "minimum",
        "motion": lambda row: row.get("reason") or None,
        "a later plan moves": lambda row: "yes" if row.get("moves") else "no",
    }
    wrong = [row for row in plans if not row.get("first_moves") or row["num_regrasps"] > row["minimum"]]
    return [
        tables.listing(
            "Arms",
            trained,
            arms,
            "Branches: configurations found for the pose of a random one, on average; with seven joints those at 31 "
            "values of the locked joint. Checks: pose-grasp pairs of the bottle at random poses. AP: average precision "
            "on grasps of the built-in objects, with the exact rules, mean and least.",
        ),
        tables.summary(
            "Plans and motions",
            ("workcell",),
            {name: found for (name,), found in tables.grouped(plans, "workcell").items()},
            columns,
            "First moves: the plan has a motion from home and back; moves: it or a later candidate has.",
        ),
        tables.listing("Pairs without a plan or a first motion, or with a larger N", wrong, missed),
    ]
