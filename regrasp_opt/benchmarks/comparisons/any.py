"""Any mesh, any scene, nothing prepared: how long the first plan takes, and how often one is found.

Whatever is timed runs in this process, one after the other; only the ground truth is checked by several workers.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from regrasp_opt.benchmarks.comparisons.speed import process_row
from regrasp_opt.benchmarks.comparisons.unseen import made_meshes, random_scene
from regrasp_opt.benchmarks.comparisons.unseen_tables import TEXT, any_tables
from regrasp_opt.benchmarks.harness.instances import Instance, PosePool, choose_instances
from regrasp_opt.benchmarks.harness.oracle import Oracle, check_poses
from regrasp_opt.benchmarks.harness.planners import PLANNERS, effort, outcome, warm_up
from regrasp_opt.benchmarks.harness.report import Report
from regrasp_opt.benchmarks.harness.runner import Item, Row, progress
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.harness.subjects import DEFAULT_WORKCELL, mesh_files
from regrasp_opt.benchmarks.paper.cross_effector import constant_energy
from regrasp_opt.connectivity.embedding import ProblemEnergy
from regrasp_opt.errors import GraspError
from regrasp_opt.feasibility.dataset import random_poses
from regrasp_opt.files import content_hash
from regrasp_opt.objects import load_object
from regrasp_opt.planning import Recipe, RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.arm_energy import find_arm_energy
from regrasp_opt.planning.recipes import RECIPES
from regrasp_opt.planning.tasks import random_task


@dataclass(frozen=True)
class AnySizes:
    """How much is measured.

    `meshes` in all, those of a folder among them, `processes` of them in fresh processes too, and `scenes`, with
    `pairs` each out of a pool of `pool` poses; `warm` pairs of each built-in object. `truth` random poses are checked
    exactly to say which pairs have a plan. A plan is given up after `time_limit` seconds.
    """

    meshes: int
    processes: int
    scenes: int
    pairs: int
    warm: int
    truth: int
    pool: int
    time_limit: float


QUICK = AnySizes(meshes=4, processes=2, scenes=2, pairs=2, warm=3, truth=300, pool=60, time_limit=5.0)
FULL = AnySizes(60, 60, 40, pairs=4, warm=25, truth=20_000, pool=200, time_limit=30.0)


DRAWN = 100
"""Pairs without a shared grasp that are drawn, to take the first ones that can be planned."""


class Contender(NamedTuple):
    """A way to plan: a problem with its energy, and a recipe."""

    problem: RegraspProblem
    recipe: str | Recipe


def run_any(session: Session) -> Report:
    """Measure plans for meshes and scenes that nothing was prepared for."""
    sizes = QUICK if session.quick else FULL
    results = replace(session, jobs=1).execute("any", list(_items(session, sizes)))
    made = tuple(any_tables(results.rows)), results.rows
    told = {"quick": session.quick, "seed": session.seed, **asdict(sizes)}
    return Report("any", "Any mesh, any scene", TEXT, *made, revisions=results.revisions, settings=told)


def _items(session: Session, sizes: AnySizes) -> Iterator[Item]:
    def item(part: str, name: str, function: partial[list[Row]], *depends: object) -> Item:
        key = content_hash(part, asdict(sizes), session.seed, *depends)
        return Item(f"{part}/{name}", key, function, (), {"part": part, "object": name})

    for name in session.names:
        yield item("built-in", name, partial(builtin_rows, name, sizes, session))
    meshes = _mesh_files(session, sizes)
    step = max(1, len(meshes) // max(1, sizes.processes))
    fresh = list(meshes)[::step][: sizes.processes]
    for name, path in meshes.items():
        rows = partial(mesh_rows, path, sizes, session, fresh_process=name in fresh)
        yield item("meshes", name, rows, path.read_bytes())
    for number in range(sizes.scenes):
        name = session.names[number % len(session.names)]
        yield item("scenes", f"scene {number}, {name}", partial(scene_rows, name, number, sizes, session), name)


def _mesh_files(session: Session, sizes: AnySizes) -> dict[str, Path]:
    """Return the meshes by name: those of the session's folder and below, and made ones, which are written to files."""
    found = [] if session.objects is None else mesh_files(session.objects, "**/*")
    meshes = {path.stem: path for path in found}
    folder = session.folder / "any" / "meshes"
    folder.mkdir(parents=True, exist_ok=True)
    for name, mesh in made_meshes(sizes.meshes - len(meshes), session.seed).items():
        meshes[name] = folder / f"{name}.stl"
        mesh.export(meshes[name])
    return meshes


def fresh_process_row(path: Path, pair: Instance) -> Row:
    """Return the row of ``regrasp-opt plan`` for a mesh file, in a fresh process with an empty data folder."""
    with tempfile.TemporaryDirectory() as home:
        words = ["plan", "--object", str(path)]
        for end in ("start", "goal"):
            file = Path(home) / f"{end}.json"
            file.write_text(json.dumps(getattr(pair, end).tolist()), encoding="utf-8")
            words += [f"--{end}", str(file)]
        return process_row("plan", words, {"REGRASP_OPT_HOME": str(Path(home) / "data")})


def mesh_rows(path: Path, sizes: AnySizes, session: Session, *, fresh_process: bool = False) -> list[Row]:
    """Return a row about the first plan of a mesh file in this warm process, and one for each pair and planner.

    With `fresh_process` there is one about the same plan as a process of its own, too. Raises a `RegraspError` if the
    mesh cannot be read, or there is no pair of poses to plan for.
    """
    drawn = RegraspProblem.load(path, DEFAULT_WORKCELL)
    pairs, share = solvable_pairs(drawn, sizes.pairs, sizes.truth, sizes.pool, session, path.stem)
    times, processor = [time.perf_counter()], time.process_time()
    body = load_object(path)
    times.append(time.perf_counter())
    problem = RegraspProblem.load(body, DEFAULT_WORKCELL)
    times.append(time.perf_counter())
    plan = _solve(Contender(problem, "ipopt"), pairs[0], sizes, session.seed)
    times.append(time.perf_counter())
    processor = time.process_time() - processor
    first = {
        "faces": len(body.faces),
        "grasps": len(problem.grasps),
        "placements": len(problem.placements),
        "share": share,
        **dict(zip(("read", "sampling", "plan"), np.diff(times).tolist(), strict=True)),
        **{f"t_{name}": seconds for name, seconds in plan.timings.items()},
        "first": times[-1] - times[0] if plan.solved else None,
        "processor": processor,
    }
    rows = [first, *([fresh_process_row(path, pairs[0])] if fresh_process else [])]
    return rows + _pair_rows(contenders(problem), pairs, sizes, session.seed)


def builtin_rows(name: str, sizes: AnySizes, session: Session) -> list[Row]:
    """Return a row for each pair and planner of a built-in object, its own energy among them."""
    ways = _builtin_contenders(name)
    pairs, _ = solvable_pairs(ways["own energy"].problem, sizes.warm, sizes.truth, sizes.pool, session, name)
    return _pair_rows(ways, pairs, sizes, session.seed)


def scene_rows(name: str, number: int, sizes: AnySizes, session: Session) -> list[Row]:
    """Return a row for each pair and planner of a built-in object between obstacles that have just been put there."""
    ways = _builtin_contenders(name)
    for way in ways.values():
        _ = way.problem.free_lattice
    base = ways["arm energy"].problem
    obstacles = random_scene(base, session.rng(8, number))
    scene = base.with_obstacles(obstacles)
    pairs, _ = solvable_pairs(scene, sizes.pairs, sizes.truth, sizes.pool, session, f"scene {number}")
    rows: list[Row] = []
    for pair in pairs:
        began, processor = time.perf_counter(), time.process_time()
        plan = _solve(Contender(base.with_obstacles(obstacles), "ipopt"), pair, sizes, session.seed)
        moved = time.perf_counter() - began if plan.solved else None
        took = {"moved": moved, "processor": time.process_time() - processor}
        rows.append({"pair": pair.name, "obstacles": len(obstacles), **took})
    there = {label: way._replace(problem=way.problem.with_obstacles(obstacles)) for label, way in ways.items()}
    return rows + _pair_rows(there, pairs, sizes, session.seed)


def contenders(problem: RegraspProblem, own: RegraspProblem | None = None) -> dict[str, Contender]:
    """Return ways to plan by name; `own` is the same problem with the energy of its object."""
    control, energy = replace(problem), ProblemEnergy(constant_energy(), problem.grasps, problem.rests.planar)
    vars(control).update(checker=problem.checker, rules=problem.rules, energy=energy)
    ways = {"arm energy": Contender(problem, "ipopt")}
    if own is not None:
        ways["own energy"] = Contender(own, "ipopt")
    ways["exact"] = Contender(problem, "exact")
    ways["constant energy"] = Contender(control, "ipopt")
    ways["random poses"] = Contender(problem, PLANNERS["random poses"]())
    return ways


@cache
def _builtin_contenders(name: str) -> dict[str, Contender]:
    own = RegraspProblem.load(name, DEFAULT_WORKCELL)
    return contenders(replace(own, model_folder=None, arm_energy=find_arm_energy(own.workcell)), own)


def solvable_pairs(
    problem: RegraspProblem, count: int, truth: int, pool_size: int, session: Session, name: str
) -> tuple[list[Instance], float | None]:
    """Return `count` pairs of poses that can be planned, and the share of those without a shared grasp that can.

    They are out of a pool of `pool_size` poses, and share no grasp unless there are too few such pairs. An exact search
    over `truth` random poses says what can be planned.

    Raises
    ------
    GraspError
        If there are none; says why.
    """
    pool = PosePool.draw(problem, session.seed, pool_size)
    if len(pool.T) < 2:
        random_task(problem, session.rng(9))  # says why there is none
        raise GraspError(f"fewer than two of {pool_size} resting poses of '{problem.object.name}' can be grasped")
    exact = _truth(problem, truth, session, name)
    drawn = choose_instances(pool, exact, {"any": DRAWN}, session.rng(9), name)
    pairs = [pair for pair in drawn if pair.minimum is not None][:count]
    pairs += choose_instances(pool, exact, {"0": count - len(pairs)}, session.rng(10), name)
    if not pairs:
        raise GraspError(f"none of {len(drawn)} pairs of poses of '{problem.object.name}' can be planned")
    return pairs, float(np.mean([pair.minimum is not None for pair in drawn])) if drawn else None


def _truth(problem: RegraspProblem, count: int, session: Session, name: str) -> Oracle:
    """Return the exact feasibility of random resting poses, which says what can be planned."""
    numbers, xi = random_poses(problem.placement_poses, problem.workcell.bounds.array, count, session.rng(11))
    with progress(session.quiet) as show:
        return check_poses(problem, numbers, xi, jobs=session.jobs, progress=partial(show, f"ground truth, {name}"))


def _pair_rows(ways: dict[str, Contender], pairs: list[Instance], sizes: AnySizes, seed: int) -> list[Row]:
    rows = []
    for label, way in ways.items():
        if way.recipe == "ipopt" and pairs:
            warm_up(way.problem, pairs[0], RECIPES["ipopt"]())
        for pair in pairs:
            processor = time.process_time()
            plan = _solve(way, pair, sizes, seed)
            processor = time.process_time() - processor
            times = {f"t_{name}": seconds for name, seconds in plan.timings.items()}
            found = {**outcome(plan, pair), **effort(plan), "unrefined": plan.solved and from_fallback(plan)}
            rows.append({"pair": pair.name, "planner": label, **found, **times, "processor": processor})
    return rows


def _solve(way: Contender, pair: Instance, sizes: AnySizes, seed: int) -> RegraspPlan:
    return solve_sequence(way.problem, pair.start, pair.goal, way.recipe, seed=seed, time_limit=sizes.time_limit)


def from_fallback(plan: RegraspPlan) -> bool:
    """Return whether a plan is a lattice chain that was verified as it is, after no refined one had been."""
    return any("accepted" in entry and "stages" not in entry for entry in plan.refiner_stats)
