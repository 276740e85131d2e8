"""One way to run an experiment: work on each object, rows from the workers, tables and figures of the rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.report import Figure, Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.harness.subjects import planning_key
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem

Work = Callable[[str, RegraspProblem], tuple[list[Item], str]]
"""From name and problem of an object to its items and the hash of its start-goal pairs."""


def run_experiment(
    session: Session,
    name: str,
    title: str,
    text: str,
    work: Work,
    tables: Callable[[list[Row], list[str]], Iterable[Table]],
    *,
    figures: Callable[[list[Row], list[str]], Iterable[Figure]] = lambda rows, names: (),
    settings: dict[str, Any] | None = None,
    most: int | None = None,
) -> Report:
    """Run the experiment `name` on the objects of a session, or on the first `most` of them.

    Parameters
    ----------
    tables, figures : callable
        Made of the rows and the names of the objects that can be evaluated.
    settings : dict, optional
        What the report tells besides size and seed.
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
    return Report(
        name,
        title,
        text,
        tuple(tables(rows, names)),
        rows,
        tuple(figures(rows, names)),
        hashes,
        results.revisions,
        {"quick": session.quick, "seed": session.seed, **(settings or {})},
    )


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

    Parameters
    ----------
    name : str
        Of the object.
    label : str
        What is put behind the instance's name, so that the item has a key of its own.
    """
    keys = [planning_key(a) if isinstance(a, RegraspProblem) else a for a in arguments]
    depends_on = content_hash(planning_key(problem), instances_hash([instance]), *keys)
    columns = {"object": name, "pair": instance.name, **columns}
    return Item(f"{instance.name}{label}", depends_on, function, (replace(problem), instance, *arguments), columns)
