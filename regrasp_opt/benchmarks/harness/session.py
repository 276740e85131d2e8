"""One run of the benchmarks: what is evaluated, at which size, by how many workers, and where the results go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import TaskID

from regrasp_opt.benchmarks.harness.instances import PosePool
from regrasp_opt.benchmarks.harness.oracle import PAPER_GRID, Oracle, Resolution, build_oracle
from regrasp_opt.benchmarks.harness.runner import Item, Results, Row, progress_bar, run_items
from regrasp_opt.benchmarks.harness.subjects import (
    DEFAULT_WORKCELL,
    Subject,
    load_bodies,
    load_subjects,
    prepared_problem,
)
from regrasp_opt.errors import RegraspError
from regrasp_opt.objects import ObjectModel
from regrasp_opt.objects.builtin import OBJECT_NAMES
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.scene import Workcell, load_workcell

QUICK_GRID = Resolution(0.06, 12)
"""The oracle of quick runs."""

COARSE_GRID = Resolution(0.04, 12)
"""The oracle of full runs for other grasps and other workcells than the experiments' own."""


@dataclass(frozen=True)
class Session:
    """Options that all experiments share.

    Attributes
    ----------
    folder : Path
        Where results are written, one folder for each experiment.
    quick : bool
        Minutes instead of the paper's sizes.
    objects : Path or None
        Folder of meshes that are evaluated besides the built-in objects.
    names : tuple of str
        Built-in objects that are evaluated.
    jobs : int
        Workers, as joblib counts them.
    seed : int
    quiet : bool
        Show no progress.
    """

    folder: Path
    quick: bool = False
    objects: Path | None = None
    names: tuple[str, ...] = OBJECT_NAMES
    jobs: int = -1
    seed: int = 0
    quiet: bool = False

    @property
    def grid(self) -> Resolution:
        """Resolution of the oracle."""
        return QUICK_GRID if self.quick else PAPER_GRID

    @property
    def coarse_grid(self) -> Resolution:
        """Resolution of the oracle for other grasps or another workcell."""
        return QUICK_GRID if self.quick else COARSE_GRID

    def bodies(self) -> tuple[dict[str, ObjectModel], list[Row]]:
        """Return the objects by name, and one row for each mesh that is none, with the reason."""
        found = load_bodies(self.objects, self.names)
        good = {name: body for name, body in found.items() if not isinstance(body, RegraspError)}
        bad: list[Row] = [{"object": n, "error": str(e)} for n, e in found.items() if isinstance(e, RegraspError)]
        return good, bad

    def subjects(self) -> list[Subject]:
        """Return everything that is evaluated in the default workcell, with prepared models."""
        with progress_bar(self.quiet) as bar:
            tasks: dict[str, TaskID] = {}

            def show(what: str, done: int, total: int) -> None:
                if what not in tasks:
                    tasks[what] = bar.add_task(what, total=total)
                bar.update(tasks[what], completed=done, total=total)

            bodies, cell = load_bodies(self.objects, self.names), load_workcell(DEFAULT_WORKCELL)
            return load_subjects(bodies, cell, jobs=self.jobs, progress=show)

    def prepared(self, problem: RegraspProblem, cell: Workcell) -> RegraspProblem:
        """Return the object of `problem` in another workcell, with a model prepared for it."""
        return prepared_problem(problem.object, cell, jobs=self.jobs)

    def oracle(self, name: str, problem: RegraspProblem, resolution: Resolution | None = None) -> Oracle:
        """Return the ground truth of `problem` on a grid; `name` is shown beside the progress."""
        with progress_bar(self.quiet) as bar:
            task = bar.add_task(f"ground truth, {name}", total=None)
            return build_oracle(
                problem,
                resolution or self.grid,
                jobs=self.jobs,
                progress=lambda done, total: bar.update(task, completed=done, total=total),
            )

    def pool(self, problem: RegraspProblem) -> PosePool:
        """Return the random poses among which start-goal pairs of `problem` are chosen."""
        return PosePool.draw(problem, self.seed)

    def rng(self, *stream: int) -> np.random.Generator:
        """Return a generator of its own for each `stream` of numbers."""
        return np.random.default_rng([self.seed, *stream])

    def execute(self, experiment: str, items: Sequence[Item]) -> Results:
        """Compute the rows of `items`, or read what an earlier run left in the experiment's folder."""
        return run_items(items, self.folder / experiment / "items", jobs=self.jobs, quiet=self.quiet)


def error_rows(subjects: Sequence[Subject]) -> list[Row]:
    """Return one row for each subject that cannot be evaluated, with the reason."""
    return [{"object": s.name, "error": s.error} for s in subjects if s.problem is None]


def usable(subjects: Sequence[Subject]) -> list[tuple[str, RegraspProblem]]:
    """Return name and problem of the subjects that can be evaluated."""
    return [(s.name, s.problem) for s in subjects if s.problem is not None]
