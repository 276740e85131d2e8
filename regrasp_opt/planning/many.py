"""`solve_many`: many tasks of one problem, on several processes or on the cluster that joblib is told to use."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import joblib
import numpy as np

from regrasp_opt.errors import OptionError, RegraspError
from regrasp_opt.files import content_hash
from regrasp_opt.planning.plan import RegraspPlan
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.planning.recipes import EXACT
from regrasp_opt.planning.search import solve_sequence
from regrasp_opt.workers import workers

PORTIONS = 8
"""Portions of tasks for each worker: enough to even out their times and to show progress."""

_held: dict[str, RegraspProblem] = {}
"""The problem that this worker process works on, by its hash: warm from its second task on."""


def solve_many(
    problem: RegraspProblem,
    pairs: Iterable[tuple[Any, Any]],
    refiner: Any = "ipopt",
    *,
    jobs: int = 2,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> list[RegraspPlan | RegraspError]:
    """Plan every pair of start and goal as `solve_sequence` does, and return the results in the order of `pairs`.

    Parameters
    ----------
    problem : RegraspProblem
    pairs : iterable of ((4, 4), (4, 4))
        Start and goal poses T_world_object.
    refiner
        Same as in `solve_sequence`.
    jobs : int
        Worker processes, as joblib counts them: 1 plans in this process, -1 uses all cores. The backend is joblib's
        current one, so within ``joblib.parallel_config(backend="dask")`` the workers are those of a Dask cluster.
    progress : callable, optional
        Called with (tasks done, tasks in all).
    **options
        Further keywords of `solve_sequence`; all tasks have the same seed.

    Returns
    -------
    list of RegraspPlan or RegraspError
        A task whose start or goal is refused has the error in its place; the others are planned.

    Raises
    ------
    OptionError
        If a pair is not two poses, or `jobs` is 0.
    """
    tasks = [tuple(pair) for pair in pairs]
    odd = next((number for number, task in enumerate(tasks) if len(task) != 2), None)
    if odd is not None:
        raise OptionError(f"pair {odd} has {len(tasks[odd])} parts; give a start and a goal pose")
    if jobs == 0:
        raise OptionError("jobs is 0; give the number of worker processes, or -1 for all cores")
    tell, results = progress or (lambda done, total: None), list[RegraspPlan | RegraspError]()
    if jobs == 1:
        for task in tasks:
            results.append(_solved(problem, task, refiner, options))
            tell(len(results), len(tasks))
        return results
    if refiner != EXACT and problem.energy_file is None:
        _ = problem.energy  # trained here and kept, so that no worker trains its own
    portions = np.array_split(np.arange(len(tasks)), max(1, min(len(tasks), PORTIONS * joblib.effective_n_jobs(jobs))))
    parts = [part.fingerprint() for part in (problem.object, problem.workcell, problem.grasps)]
    key = content_hash(*parts, str(problem.model_folder), str(problem.arm_energy), problem.preset)
    with workers(jobs, "generator") as parallel:
        work = [joblib.delayed(_portion)(problem, key, [tasks[i] for i in part], refiner, options) for part in portions]
        for found in parallel(work):
            # Plans travel without their problem, which is large and here already.
            results += [replace(one, problem=problem) if isinstance(one, RegraspPlan) else one for one in found]
            tell(len(results), len(tasks))
    return results


def _portion(problem: RegraspProblem, key: str, tasks: list[Any], refiner: Any, options: dict[str, Any]) -> list[Any]:
    """Return the results of some tasks, plans without their problem; runs in a worker."""
    if key not in _held:
        _held.clear()
        _held[key] = problem
    results = [_solved(_held[key], task, refiner, options) for task in tasks]
    return [replace(one, problem=None) if isinstance(one, RegraspPlan) else one for one in results]  # type: ignore[arg-type]


def _solved(
    problem: RegraspProblem, ends: tuple[Any, Any], refiner: Any, options: dict[str, Any]
) -> RegraspPlan | RegraspError:
    try:
        return solve_sequence(problem, ends[0], ends[1], refiner, **options)
    except RegraspError as error:
        return error
