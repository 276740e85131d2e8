"""Plans in adversity: no wrong plan may get out, no good one may get lost.

Every trial plans between two random poses, half of the pairs sharing no grasp. All refined candidates are kept that
the learned energy takes for plans (every pair of neighbours has a grasp whose summed energies are below the threshold
``h``, Alg. 2), and checked exactly: the share that fails is what an optimiser gains by seeking out the model's
mistakes. Every claim of the plan that comes out is verified twice: by its certificate, and by the verifier of
`tests/oracles`, from what the plan's file says. A trial that ends without a plan is asked of the exact grid oracle.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np
from oracles.plans import PlanVerifier

from regrasp_opt.benchmarks.harness.instances import Instance, PosePool
from regrasp_opt.benchmarks.harness.oracle import Oracle
from regrasp_opt.benchmarks.harness.runner import Row
from regrasp_opt.benchmarks.harness.subjects import resident
from regrasp_opt.benchmarks.paper.hard_tiers import with_obstacles
from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.files import atomic_path
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.planning import Recipe, RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.verification import PoseFeasibility, verify_sequence
from regrasp_opt.scene import Workcell, load_workcell
from regrasp_opt.solvers import Candidates, NlpRefiner, RecordingRefiner

DATA = Path(str(files("regrasp_opt"))) / "data"
MAX_REGRASPS = 3
TIME_LIMIT = 30.0
"""Seconds after which a trial gives up; it then counts as one without a plan."""
FEW_GRASPS = 20
"""Grasps that are left in the trials with few of them."""
WORKCELLS = ("nova2-w", "nova2-r140", "nova2-s1")
OBSTACLES = "nova2-w with obstacles"


@dataclass(frozen=True)
class Condition:
    """What is made hard: the grasps that are left, and whose energy is used."""

    label: str
    grasps: int | None = None
    preset: Literal["default", "paper"] = "default"


CONDITIONS = (
    Condition("all grasps"),
    Condition(f"{FEW_GRASPS} grasps", FEW_GRASPS),
    Condition("paper's energy", None, "paper"),
)


def workcells(folder: Path, quick: bool) -> Iterator[tuple[str, Workcell]]:
    """Yield the workcells of the campaign by name; the one with obstacles is written to `folder` as a file."""
    names = WORKCELLS[:1] if quick else WORKCELLS
    for name in names:
        yield name, load_workcell(name)
    if not quick:
        yield OBSTACLES, load_workcell(write_obstacles(folder / "obstacles.toml"))


def write_obstacles(path: Path) -> Path:
    """Write the workcell nova2-w with a wall and two posts to `path`, and return its absolute path."""
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
    for box in with_obstacles(load_workcell("nova2-w")).obstacles:
        assert isinstance(box, Box)
        position, size = (", ".join(f"{v:g}" for v in values) for values in (box.pose[:3, 3], box.size))
        text += f'\n[[obstacles]]\ntype = "box"\nname = "{box.name}"\nposition = [{position}]\nsize = [{size}]\n'
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path.resolve()


def reduced(problem: RegraspProblem, condition: Condition, rng: np.random.Generator) -> tuple[RegraspProblem, IntArray]:
    """Return `problem` under `condition`, and the numbers of the grasps that are left."""
    count = len(problem.grasps)
    ids = np.arange(count)
    if condition.grasps is not None and condition.grasps < count:
        ids = np.sort(rng.permutation(count)[: condition.grasps])
    return replace(problem, grasps=problem.grasps.subset(ids), preset=condition.preset), ids


def choose_pairs(pool: PosePool, count: int, rng: np.random.Generator, prefix: str) -> list[Instance]:
    """Return `count` random pairs of pool poses, every other one with no grasp in common as far as there are such."""
    rows = pool.feasible.astype(np.float32)
    apart = np.argwhere((rows @ rows.T) == 0)
    chosen = []
    for number in range(count if len(pool.T) > 1 else 0):
        if number % 2 == 0 and len(apart):
            i, j = apart[rng.integers(len(apart))]
        else:
            i, j = rng.choice(len(pool.T), 2, replace=False)
        chosen.append(Instance(f"{prefix}/{number}", pool.T[i], pool.T[j], None))
    return chosen


def trial_rows(problem: RegraspProblem, instances: list[Instance], seed: int) -> list[Row]:
    """Return one row for each of `instances`."""
    problem, verifier = resident(problem), _Verifier()
    return [_trial(problem, instance, seed, verifier) for instance in instances]


class _Verifier:
    """Verifies plans of one problem, with bodies that are read once, from the files that the first plan names."""

    def __init__(self) -> None:
        self._verifier: PlanVerifier | None = None

    def problems(self, plan: RegraspPlan) -> list[str]:
        with tempfile.TemporaryDirectory() as folder:
            plan.save(Path(folder) / "plan.json")
            content = json.loads((Path(folder) / "plan.json").read_text("utf-8"))
        self._verifier = self._verifier or PlanVerifier(content)
        return [*plan.residuals().problems, *self._verifier.problems(content)]


def _trial(problem: RegraspProblem, instance: Instance, seed: int, verifier: _Verifier) -> Row:
    recorder = RecordingRefiner(NlpRefiner(), paths=False)
    plan = solve_sequence(
        problem,
        instance.start,
        instance.goal,
        Recipe(recorder),
        max_regrasps=MAX_REGRASPS,
        seed=seed,
        time_limit=TIME_LIMIT,
    )
    low, failed = _low_energy(problem, instance, [batch.refinement.candidates for batch in recorder.batches])
    wrong = verifier.problems(plan) if plan.solved else []
    return {
        "pair": instance.name,
        "status": plan.status.name.lower(),
        "solved": plan.solved,
        "num_regrasps": plan.num_regrasps if plan.solved else None,
        "low": low,
        "low_failed": failed,
        "wrong": "; ".join(wrong[:3]),
        "seconds": round(plan.timings["total"], 3),
    }


def _low_energy(problem: RegraspProblem, instance: Instance, kept: list[Candidates]) -> tuple[int, int]:
    """Return how many candidates the learned energy takes for plans, and how many of these are none."""
    known: dict[bytes, PoseFeasibility] = {}

    def knowledge(T: FloatArray) -> PoseFeasibility:
        return known.setdefault(T.tobytes(), PoseFeasibility(problem.checker, T))

    h = problem.energy.model.threshold
    low = failed = 0
    for candidates in kept:
        for placements, xi in zip(candidates.placements, candidates.xi, strict=True):
            middle = [problem.pose(int(m), *values) for m, values in zip(placements, xi, strict=True)]
            poses = np.stack([instance.start, *middle, instance.goal])
            energies = problem.energy(poses)
            if not ((energies[:-1] + energies[1:]) <= h).any(axis=1).all():
                continue
            low += 1
            chain = [knowledge(T) for T in poses]
            blocked = any(pose.object_collides for pose in chain[1:-1])
            failed += blocked or not verify_sequence(chain, energies)
    return low, failed


def minimum_on_grid(problem: RegraspProblem, oracle: Oracle, instance: Instance) -> int | None:
    """Return the fewest regrasps that the grid of `problem` needs, or None."""
    least = oracle.minimum_table(np.array([problem.feasible_grasps(T) for T in instance.ends]))[0, 1]
    return int(least) if np.isfinite(least) else None
