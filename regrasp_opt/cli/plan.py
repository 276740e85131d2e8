"""`regrasp-opt plan`."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape

from regrasp_opt.cli.output import make_console, plain_table, working
from regrasp_opt.conventions import as_seed
from regrasp_opt.errors import PoseError, RegraspError
from regrasp_opt.planning import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.arm_energy import train_arm_energy
from regrasp_opt.planning.ends import resting_end
from regrasp_opt.planning.explanation import Explanation
from regrasp_opt.planning.plan_file import plan_summary
from regrasp_opt.planning.pose_text import describe_pose, parse_pose
from regrasp_opt.planning.problem_data import TRAINING_SAID
from regrasp_opt.planning.recipes import EXACT, as_recipe
from regrasp_opt.planning.tasks import Task, random_task

logger = logging.getLogger(__name__)


def run_plan(
    problem: RegraspProblem,
    start: str | None,
    goal: str | None,
    search: dict[str, Any],
    *,
    explain: bool,
    out: Path | None,
    html: Path | None,
    as_json: bool,
) -> int:
    """Plan with the options `search` of `solve_sequence`, print and save; return 0 if solved, else 1.

    Where there is no plan the output says why, and with `explain` what would help, also against a pose that is refused.
    """
    exact = search["refiner"] == EXACT
    if not exact:
        as_recipe(search["refiner"])  # an unknown name is refused before anything is trained for it
    with working("drawing a task", None):
        task = _task(problem, start, goal, search["seed"], search["tolerance"])
    if not exact and problem.energy_file is None:
        from regrasp_opt.benchmarks.harness.runner import progress

        arm = problem.workcell.arm
        logger.warning(TRAINING_SAID, arm.robot.name, arm.end_effector.name)
        with progress() as show:
            train_arm_energy(problem.workcell, progress=show)
    logger.info("%d grasps, %d placements", len(problem.grasps), len(problem.rests))
    try:
        with working(f"planning up to {search['max_regrasps']} regrasp(s)", search["time_limit"]):
            plan = solve_sequence(problem, task.start, task.goal, **search)
    except PoseError:
        if explain and not as_json:
            _explain_refused(problem, task)
        raise
    for tried in plan.refiner_stats:
        logger.info("tried %s", ", ".join(f"{key} {value}" for key, value in tried.items()))
    logger.info("%s; seconds: %s", plan.status.name.lower(), {k: round(v, 3) for k, v in plan.timings.items()})
    if out is not None:
        plan.save(out)
    if html is not None:
        from regrasp_opt.viz import write_plan_page

        write_plan_page(plan, html)
    explanation = None
    if not plan.solved:
        with working("looking for what would help" if explain else "looking for the causes"):
            explanation = plan.explain(remedies=explain)
    if as_json:
        more: dict[str, Any] = {"remarks": plan.remarks} if plan.remarks else {}
        more |= {} if explanation is None else {"explanation": explanation.data()}
        if search["alternatives"]:
            more |= {"alternatives": [plan_summary(other) for other in plan.alternatives]}
        print(json.dumps(plan_summary(plan) | more, allow_nan=False))
    else:
        _print(plan, explanation, [path for path in (out, html) if path is not None])
        if explanation is not None and explanation.causes and not explain:
            make_console().print("--explain tries what would help")
    return 0 if plan.solved else 1


def _task(
    problem: RegraspProblem, start: str | None, goal: str | None, seed: int, tolerance: tuple[float, float]
) -> Task:
    """Return both ends as they were given; one that was not is drawn for the resting pose that the other means."""
    ends = {name: text for name, text in (("start", start), ("goal", goal)) if text is not None}
    given = {name: parse_pose(text, name, problem) for name, text in ends.items()}
    if len(given) == 2:
        return Task(given["start"], given["goal"], -1)
    rng = np.random.default_rng(as_seed(seed))
    rest = {name: resting_end(T, name, problem, tolerance)[0] for name, T in given.items()}
    try:
        task = random_task(problem, rng, start=rest.get("start"), goal=rest.get("goal"), needs_regrasp=True)
    except RegraspError:
        task = random_task(problem, rng, start=rest.get("start"), goal=rest.get("goal"))
    return Task(given.get("start", task.start), given.get("goal", task.goal), task.shared)


def _explain_refused(problem: RegraspProblem, task: Task) -> None:
    """Say what is wrong with each end that is refused, and where it could be."""
    for name, T in (("start", task.start), ("goal", task.goal)):
        with working(f"looking for another {name}"):
            explanation = problem.explain(T)
        if explanation.causes:
            make_console().print(f"{name}: {explanation}", markup=False, soft_wrap=True)


def _print(plan: RegraspPlan, explanation: Explanation | None, written: list[Path]) -> None:
    console = make_console()
    problem = plan.problem
    colour = "green" if plan.solved else "red"
    text = escape(plan.status.value.removeprefix("solved: "))
    console.print(f"[bold {colour}]{plan.status.name.lower()}[/]: {text}", soft_wrap=True)
    for line in [] if explanation is None else explanation.lines():
        console.print(f"  {line}", markup=False, soft_wrap=True)
    if plan.solved:
        console.print(
            f"{escape(problem.object.name)} in {escape(problem.workcell.name)}: {plan.num_regrasps} regrasp(s), "
            f"J_seq {plan.cost:.2f}, {plan.timings['total']:.2f} s"
        )
        table = plain_table("move", "from", "to", "shared grasps", "clearance [mm]", right=2)
        for i, transition in enumerate(plan.transitions):
            clearance = f"{1e3 * transition.clearance.max():.1f}"
            ends = [describe_pose(T, problem) for T in plan.poses[i : i + 2]]
            table.add_row(str(i), *ends, str(len(transition.grasp_ids)), clearance)
        console.print(table)
    for number, other in enumerate(plan.alternatives, start=1):
        through = ", ".join(describe_pose(T, problem) for T in other.poses[1:-1]) or "no other pose"
        console.print(f"alternative {number}: J_seq {other.cost:.2f}, through {through}", markup=False, soft_wrap=True)
    for remark in plan.remarks:
        console.print(f"[bold]note[/]: {escape(remark)}", soft_wrap=True)
    for path in written:
        console.print(f"written: {path}", markup=False, soft_wrap=True)
