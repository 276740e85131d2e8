"""`regrasp-opt check`."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
from rich.markup import escape

from regrasp_opt.cli.output import make_console, plain_table
from regrasp_opt.planning import RegraspPlan

logger = logging.getLogger(__name__)


def run_check(path: Path, *, as_json: bool) -> int:
    """Recompute every claim of a saved plan; return 0 if it is solved and all hold, else 1."""
    plan = RegraspPlan.load(path)
    residuals = plan.residuals()
    counts = [len(t.limit_margin) for t in residuals.transitions]
    logger.info("recomputed %s grasps of %d transition(s)", counts, len(counts))
    good = plan.solved and residuals.hold
    problems = list(residuals.problems) if plan.solved else [f"the plan is not solved: {plan.status.name.lower()}"]
    if as_json:
        rows = [
            {
                "grasps": len(t.limit_margin),
                "position_error": float(t.position_error.max(initial=0.0)),
                "rotation_error": float(t.rotation_error.max(initial=0.0)),
                "limit_margin": float(t.limit_margin.min(initial=np.pi)),
                "collision_margin": float(t.collision_margin.min(initial=1.0)),
            }
            for t in residuals.transitions
        ]
        print(json.dumps({"holds": good, "problems": problems, "remarks": plan.remarks, "transitions": rows}))
        return 0 if good else 1
    console = make_console()
    margins = "limit margin [rad]", "collision margin [mm]"
    table = plain_table("transition", "grasps", "FK error [m]", "FK error [rad]", *margins, right=6)
    for i, t in enumerate(residuals.transitions):
        table.add_row(
            str(i),
            str(len(t.limit_margin)),
            f"{t.position_error.max(initial=0.0):.1e}",
            f"{t.rotation_error.max(initial=0.0):.1e}",
            f"{t.limit_margin.min(initial=np.pi):.3f}",
            f"{1e3 * t.collision_margin.min(initial=1.0):+.2f}",
        )
    console.print(table)
    for remark in plan.remarks:
        console.print(f"[bold]note[/]: {escape(remark)}", soft_wrap=True)
    if good:
        console.print(f"[bold green]holds[/]: every one of the {len(plan.transitions)} transition(s) holds")
        return 0
    for text in problems:
        console.print(f"[bold red]does not hold[/]: {escape(text)}", soft_wrap=True)
    return 1
