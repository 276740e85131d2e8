"""One run of the benchmarks, and the one way to run an experiment in it.

A session says what is evaluated, at which size, by how many workers, and where the results go. An experiment is the
work on each object, and the tables and figures that are made from the rows that the workers return.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from regrasp_opt.benchmarks.harness.instances import Instance, PosePool, choose_instances, instances_hash
from regrasp_opt.benchmarks.harness.oracle import PAPER_GRID, Oracle, Resolution, build_oracle
from regrasp_opt.benchmarks.harness.report import Figure, Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Results, Row, progress, run_items
from regrasp_opt.benchmarks.harness.subjects import (
    DEFAULT_WORKCELL,
    TrainingRequest,
    mesh_files,
    planning_key,
    prepared_problem,
    trained_energies,
)
from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.errors import RegraspError
from regrasp_opt.files import content_hash
from regrasp_opt.objects import ObjectModel, load_object
from regrasp_opt.objects.builtin import OBJECT_NAMES
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.scene import Workcell, load_workcell

Made = TypeVar("Made")
QUICK_GRID = Resolution(0.06, 12)
"""The oracle of quick runs."""

COARSE_GRID = Resolution(0.04, 12)
"""The oracle of full runs for other grasps and other workcells than the experiments' own."""


@dataclass(frozen=True)
class Session:
    """Options that all experiments share.

    Results are written to `folder`, one folder for each experiment. A `quick` session takes minutes instead of the
    paper's sizes, a `quiet` one shows no progress. The built-in objects `names` and the meshes in the folder `objects`
    are evaluated by `jobs` workers, as joblib counts them.
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
        """Return the objects by name, and one row for each mesh that cannot be used, with the reason."""
        return self._each(load_object)

    def subjects(self) -> tuple[dict[str, RegraspProblem], list[Row]]:
        """Return the problem of each object in the default workcell, and one row for each that has none, with why.

        Models are prepared where there are none.
        """
        cell = load_workcell(DEFAULT_WORKCELL)
        with progress(self.quiet) as show:
            return self._each(lambda s: prepared_problem(load_object(s), cell, jobs=self.jobs, progress=show))

    def _each(self, make: Callable[[str | Path], Made]) -> tuple[dict[str, Made], list[Row]]:
        meshes = [] if self.objects is None else mesh_files(self.objects)
        sources: dict[str, str | Path] = {name: name for name in self.names} | {path.name: path for path in meshes}
        found: dict[str, Made] = {}
        bad: list[Row] = []
        for name, source in sources.items():
            try:
                found[name] = make(source)
            except RegraspError as error:
                bad.append({"object": name, "error": str(error)})
        return found, bad

    def prepared(self, problem: RegraspProblem, cell: Workcell) -> RegraspProblem:
        """Return the object of `problem` in another workcell, with a model prepared for it."""
        return prepared_problem(problem.object, cell, jobs=self.jobs)

    def oracle(self, name: str, problem: RegraspProblem, resolution: Resolution | None = None) -> Oracle:
        """Return the ground truth of `problem` on a grid; `name` is shown beside the progress."""
        with progress(self.quiet) as show:
            told = partial(show, f"ground truth, {name}")
            return build_oracle(problem, resolution or self.grid, jobs=self.jobs, progress=told)

    def trained(self, requests: Sequence[TrainingRequest]) -> list[EnergyModel]:
        """Return the energies of `requests`, which are trained where that was not done before."""
        with progress(self.quiet) as show:
            return trained_energies(requests, jobs=self.jobs, progress=partial(show, "training"))

    def chosen(
        self, name: str, problem: RegraspProblem, oracle: Oracle, wanted: dict[str, int], *stream: int
    ) -> list[Instance]:
        """Return start-goal pairs of the object `name` as `choose_instances` does, drawn from a stream of numbers."""
        return choose_instances(self.pool(problem), oracle, wanted, self.rng(*stream), name)

    def pool(self, problem: RegraspProblem) -> PosePool:
        """Return the random poses among which start-goal pairs of `problem` are chosen."""
        return PosePool.draw(problem, self.seed)

    def rng(self, *stream: int) -> np.random.Generator:
        """Return a generator of its own for each `stream` of numbers."""
        return np.random.default_rng([self.seed, *stream])

    def execute(self, experiment: str, items: Sequence[Item]) -> Results:
        """Compute the rows of `items`, or read what an earlier run left in the experiment's folder."""
        return run_items(items, self.folder / experiment / "items", jobs=self.jobs, quiet=self.quiet)


Work = Callable[[str, RegraspProblem], tuple[list[Item], str]]
"""From name and problem of an object to its items and the hash of its start-goal pairs."""


def run_experiment(
    session: Session,
    name: str,
    title: str,
    text: str,
    work: Work,
    tables: Iterable[Callable[[list[Row], list[str]], Table | list[Table]]],
    *,
    figures: Callable[[list[Row], list[str]], Iterable[Figure]] = lambda rows, names: (),
    settings: dict[str, Any] | None = None,
    most: int | None = None,
) -> Report:
    """Run the experiment `name` on the objects of a session, or on the first `most` of them.

    Each of the `tables`, or several at once, and `figures` are made of the rows and the names of the objects that can
    be evaluated; `settings` is what the report tells besides size and seed.
    """
    problems, unusable = session.subjects()
    chosen = list(problems.items())[:most]
    items: list[Item] = []
    hashes: dict[str, str] = {}
    for object_name, problem in chosen:
        found, hashes[object_name] = work(object_name, problem)
        items += found
    results = session.execute(name, items)
    rows, names = results.rows + unusable, list(hashes)
    made: list[Table] = []
    for make in tables:
        table = make(rows, names)
        made += [table] if isinstance(table, Table) else table
    drawn, told = tuple(figures(rows, names)), {"quick": session.quick, "seed": session.seed, **(settings or {})}
    return Report(name, title, text, tuple(made), rows, drawn, hashes, results.revisions, told)


def pair_item(
    name: str,
    problem: RegraspProblem,
    instance: Instance,
    function: Callable[..., list[Row]],
    *arguments: Any,
    label: str = "",
    **columns: Any,
) -> Item:
    """Return the item that calls `function` with `problem`, `instance` and `arguments`, on which its rows depend.

    `name` is the object's; `label` is put behind the instance's, so that the item has a key of its own.
    """
    keys = [planning_key(a) if isinstance(a, RegraspProblem) else a for a in arguments]
    depends_on = content_hash(planning_key(problem), instances_hash([instance]), *keys)
    columns = {"object": name, "pair": instance.name, **columns}
    return Item(f"{instance.name}{label}", depends_on, function, (replace(problem), instance, *arguments), columns)
