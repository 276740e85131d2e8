"""Ablations: what each choice of our energy and cost is worth, one change at a time from the default."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.generation import GENERATORS, NO_GRASP, OneStepTask, generate
from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.report import Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, run_experiment
from regrasp_opt.benchmarks.harness.subjects import TrainingRequest, problem_key, resident
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.energy.training import PRESETS, TrainingOptions
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.solvers import NlpRefiner

TEXT = (
    "One change at a time from the default energy and cost. AP and shared F1 are on held-out poses; S.V. is of one-"
    "step generation; the solver's figures are of the ten cheapest poses of each pair, refined by Ipopt."
)
PAIRS = {True: 3, False: 10}
"""Pairs an object, in quick and in full runs."""
SAMPLES = {True: 4_000, False: 20_000}
"""Feasible samples that the default is trained on, in quick and in full runs."""
OBJECTS = {True: 1, False: 4}
"""Objects, the built-in ones first: every variant is trained for each."""
K_TOP = (200, 10)
PER_PLACEMENT = 200
SOLVES = 10


@dataclass(frozen=True)
class Variant:
    """A change: of the training, of the share of the samples, of the cost, or of the number of grasps."""

    training: TrainingOptions = PRESETS["default"]
    samples: float = 1.0
    cost: CostOptions = field(default_factory=CostOptions)
    grasps: int | None = None


VARIANTS: dict[str, Variant] = {
    "default": Variant(),
    "paper's preset": Variant(PRESETS["paper"]),
    "features [T, g]": Variant(TrainingOptions(features="paper")),
    "SELU": Variant(TrainingOptions(activation="selu")),
    "tanh": Variant(TrainingOptions(activation="tanh")),
    "unbounded": Variant(TrainingOptions(bounded=False)),
    "no width": Variant(TrainingOptions(use_width=False)),
    "hidden 32": Variant(TrainingOptions(hidden=32)),
    "hidden 128": Variant(TrainingOptions(hidden=128)),
    "samples / 4": Variant(samples=0.25),
    "samples / 2": Variant(samples=0.5),
    "lambda_reg 0": Variant(cost=CostOptions(lambda_reg=0.0)),
    "lambda_reg 2": Variant(cost=CostOptions(lambda_reg=2.0)),
    "grasps 50": Variant(grasps=50),
    "grasps 100": Variant(grasps=100),
}


def run_ablations(session: Session) -> Report:
    """Measure every variant on the first objects; quick runs take one, and fewer samples."""
    samples, seed = SAMPLES[session.quick], session.seed

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        oracle = session.oracle(name, problem)
        pairs = session.chosen(name, problem, oracle, {"1": PAIRS[session.quick]}, 70)
        requests = [
            TrainingRequest(problem, replace(v.training, seed=seed), round(samples * v.samples))
            for v in VARIANTS.values()
        ]
        frozen, items = instances_hash(pairs), []
        for label, energy in zip(VARIANTS, session.trained(requests), strict=True):
            key = content_hash(problem_key(problem), energy.fingerprint(), frozen, seed, PER_PLACEMENT, SOLVES)
            arguments = (replace(problem), energy, label, pairs, seed)
            items.append(Item(f"{name}/{label}", key, measure_variant, arguments, {"object": name, "variant": label}))
        return items, frozen

    settings = {"samples": samples, "oracle": str(session.grid)}
    most = OBJECTS[session.quick]
    return run_experiment(session, "ablations", "Ablations", TEXT, work, (_tables,), settings=settings, most=most)


def measure_variant(
    problem: RegraspProblem, model: EnergyModel, label: str, pairs: list[Instance], seed: int
) -> list[Row]:
    """Return one row with the held-out figures of `model`, and one row for each pair."""
    variant = VARIANTS[label]
    problem = resident(replace(problem, grasps=problem.grasps.subset(np.arange(len(problem.grasps))[: variant.grasps])))
    energy = GraspEnergy(model, problem.grasps)
    held_out = model.metadata["held_out"]
    rows: list[Row] = [{"ap": held_out["average_precision"], "shared_f1": held_out["shared_f1"]}]
    for number, instance in enumerate(pairs):
        task = OneStepTask(problem, energy, instance.ends)
        found = _measure(task, variant, [seed, 71, number]) if task.possible else {"skipped": NO_GRASP}
        rows.append({"pair": instance.name, **found})
    return rows


def _measure(task: OneStepTask, variant: Variant, stream: list[int]) -> Row:
    generator = GENERATORS["lattice"]
    rng = np.random.default_rng(stream)
    found = generate(task, generator, variant.cost, PER_PLACEMENT, rng).take(slice(0, max(K_TOP)))
    valid = task.verdicts(found.placements[:, 0], found.xi[:, 0])
    starts = found.take(slice(0, SOLVES))
    objective = task.objective(generator, variant.cost)
    refiner = NlpRefiner()
    refiner.refine(objective, starts.take(slice(0, 1)), rng)  # builds the solver
    began = time.perf_counter()
    refined = refiner.refine(objective, starts, rng)
    seconds = time.perf_counter() - began
    refined_valid = task.verdicts(starts.placements[:, 0], refined.candidates.xi[:, 0])
    return {
        **{f"sv_{k}": float(valid[:k].mean()) for k in K_TOP},
        "sv_refined": float(refined_valid.mean()),
        "converged": refined.stats["converged"] / len(starts),
        "iterations": float(np.mean(refined.stats["iterations"])),
        "solve_ms": 1e3 * seconds / len(starts),
        "gain": float((starts.cost - refined.candidates.cost).mean()),
    }


def _tables(rows: list[Row], names: list[str]) -> list[Table]:
    found = tables.grouped(rows, "object", "variant")
    columns = {
        "AP": tables.average("ap", 4),
        "shared F1": tables.average("shared_f1", 4),
        **{f"S.V. {k} [%]": tables.share(f"sv_{k}") for k in K_TOP},
        "refined S.V. [%]": tables.share("sv_refined"),
        "converged [%]": tables.share("converged"),
        "iterations": tables.average("iterations", 1),
        "solve [ms]": tables.middle("solve_ms", 1),
        "gain in J": tables.average("gain"),
    }
    note = (
        f"Refined S.V., converged, iterations, time and gain: Ipopt from the {SOLVES} cheapest poses of each pair. "
        "Costs of different energies are not comparable, and neither are their gains."
    )
    groups = {name: {label: found.get((name, label), []) for label in VARIANTS} for name in names}
    return [tables.summary(name, ("variant",), own, columns, note) for name, own in groups.items()]
