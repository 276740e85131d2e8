"""`regrasp-opt prepare`."""

from __future__ import annotations

import json
import logging
from typing import Any

from rich.markup import escape

from regrasp_opt.benchmarks.harness.runner import progress
from regrasp_opt.cli.output import make_console, plain_table, say_written
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning.arm_energy import train_arm_energy
from regrasp_opt.planning.prepare import prepare
from regrasp_opt.scene import Workcell

logger = logging.getLogger(__name__)


def run_prepare(workcell: Workcell, as_json: bool, **options: Any) -> int:
    """Train the energy of an arm with the `options` of `train_arm_energy`, with progress on a terminal; return 0."""
    with progress() as show:
        path, card = train_arm_energy(workcell, progress=show, **options)
    logger.info("seconds: %s", {name: round(seconds, 2) for name, seconds in card["times"].items()})
    if as_json:
        print(json.dumps({"path": str(path), **card}))
        return 0
    console = make_console()
    console.print(
        f"[bold green]prepared[/] {escape(card['robot'])} with {escape(card['end_effector'])}: "
        f"{card['feasible_poses']} feasible of {card['poses']} tool poses"
    )
    unseen = ", ".join(f"{escape(name)} {value:.3f}" for name, value in card["unseen"].items())
    console.print(f"average precision on objects that it never saw: {unseen or 'the tool holds no built-in object'}")
    say_written(path)
    return 0


def run_prepare_object(model: ObjectModel, workcell: Workcell, as_json: bool, **options: Any) -> int:
    """Prepare a model of an object with the `options` of `prepare`, with progress on a terminal; return 0."""
    with progress() as show:
        folder, report = prepare(model, workcell, progress=show, **options)
    logger.info("seconds: %s", {name: round(seconds, 2) for name, seconds in report["times"].items()})
    if as_json:
        print(json.dumps({"folder": str(folder), **report}))
        return 0
    console = make_console()
    console.print(
        f"[bold green]prepared[/] {escape(model.name)} for {escape(workcell.name)}: {report['grasps']} grasps, "
        f"{report['placements']} placements, {report['feasible_pairs']} feasible of {report['pairs']} pairs"
    )
    table = plain_table("energy", "held-out AP", "AUROC", "F1", "shared F1", "h", right=5)
    for name, held_out in report["held_out"].items():
        figures = [held_out[key] for key in ("average_precision", "auroc", "f1", "shared_f1")]
        table.add_row(name, *(f"{value:.3f}" for value in (*figures, report["threshold"][name])))
    console.print(table)
    bins = report["held_out"]["default"]["reliability"]
    pairs = ", ".join(f"{b['predicted']:.2f} -> {b['observed']:.2f}" for b in bins)
    console.print(f"reliability (predicted -> observed): {pairs}")
    say_written(folder)
    return 0
