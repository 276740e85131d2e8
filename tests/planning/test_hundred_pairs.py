"""One hundred random tasks for each built-in object: nearly all solvable ones are solved, and no "solved" is false."""

from collections import deque

import numpy as np
import pytest
from verifying import plan_problems, plan_verifier

from regrasp_opt import RegraspProblem, Status, solve_sequence
from regrasp_opt.conventions import planar_transform
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.solvers import NlpRefiner

TASKS = 100


class ExactGrid:
    """Poses 6 cm and 30 degrees apart over all placements, with their exact feasible grasps, made when first asked."""

    def __init__(self, problem, spacing=0.06, yaws=12):
        (x0, y0), (x1, y1) = problem.workcell.bounds.array
        axes = (
            np.arange(x0, x1 + 1e-9, spacing),
            np.arange(y0, y1 + 1e-9, spacing),
            np.arange(yaws) * 2 * np.pi / yaws,
        )
        xi = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        poses = (planar_transform(xi)[:, None] @ problem.placement_poses[None]).reshape(-1, 4, 4)
        sets = [problem.checker.feasible(T) for T in poses]
        self.sets = np.array([one for one in sets if one.any()])

    def regrasps(self, start, goal):
        """Return the fewest grid poses that link the feasible sets (G,) of start and goal, or None."""
        depth = np.where((self.sets & start).any(axis=1), 1, 0)
        queue = deque(np.flatnonzero(depth).tolist())
        while queue:
            k = queue.popleft()
            if (self.sets[k] & goal).any():
                return int(depth[k])
            fresh = np.flatnonzero((depth == 0) & (self.sets & self.sets[k]).any(axis=1))
            depth[fresh] = depth[k] + 1
            queue.extend(fresh.tolist())
        return None


def record_costs(monkeypatch):
    """Return a list that gets (start costs, refined costs), both recomputed, at every call of the NLP refiner."""
    seen = []
    refine = NlpRefiner.refine

    def recorded(self, objective, starts, rng):
        refinement = refine(self, objective, starts, rng)
        after = refinement.candidates
        before = objective.cost(starts.placements, starts.xi)
        seen.append((before, objective.cost(after.placements, after.xi)))
        return refinement

    monkeypatch.setattr(NlpRefiner, "refine", recorded)
    return seen


@pytest.mark.parametrize("name", ["bottle", "mug", "pentagon", "figurine"])
def test_a_hundred_random_pairs(name, monkeypatch):
    problem = RegraspProblem.load(name, "nova2-w")
    verifier = plan_verifier(problem)
    costs = record_costs(monkeypatch)
    rng, picker = np.random.default_rng([2024, len(name)]), np.random.default_rng(0)
    unsolved, false, disjoint, solves, converged, regrasps = [], [], 0, 0, 0, []
    for number in range(TASKS):
        task = random_task(problem, rng, needs_regrasp=True if number % 2 == 0 else None)
        shared = problem.feasible_grasps(task.start) & problem.feasible_grasps(task.goal)
        disjoint += not shared.any()
        plan = solve_sequence(problem, task.start, task.goal, refiner="ipopt", max_regrasps=5, seed=number)
        solves += sum(entry.get("solves", 0) for entry in plan.refiner_stats)
        converged += sum(entry.get("converged", 0) for entry in plan.refiner_stats)
        if plan.status is not Status.SOLVED:
            unsolved.append(task)
            continue
        regrasps.append(plan.num_regrasps)

        def rows(count, whole=number % 10 == 0):
            return range(count) if whole else {int(picker.integers(count)), int(picker.integers(count))}

        np.testing.assert_allclose(plan.poses[[0, -1]], [task.start, task.goal], atol=1e-12)
        false += [f"task {number}: {text}" for text in plan_problems(plan, rows, verifier)]

    solvable = TASKS
    if unsolved:
        grid = ExactGrid(problem)
        sets = [(problem.feasible_grasps(task.start), problem.feasible_grasps(task.goal)) for task in unsolved]
        solvable -= sum(grid.regrasps(*ends) is None for ends in sets)
    solved = len(regrasps)
    before, after = (np.concatenate([pair[side] for pair in costs]) for side in (0, 1))
    print(
        f"\n{name}: {solved} of {solvable} solvable tasks solved ({TASKS} tasks, {disjoint} with no shared grasp), "
        f"regrasps {np.bincount(regrasps).tolist()}, false plans {len(false)}, "
        f"solves converged {converged} of {solves}"
    )
    assert not false
    assert disjoint >= TASKS / 2
    assert solved >= 0.98 * solvable
    assert solves > 0 and converged >= 0.95 * solves
    assert (after <= before + 1e-9 * np.maximum(1, np.abs(before))).all()


def test_the_grid_search_finds_the_fewest_regrasps():
    problem = RegraspProblem.load("bottle", "nova2-w")
    grid = ExactGrid(problem, spacing=0.15, yaws=6)
    task = random_task(problem, np.random.default_rng(0), needs_regrasp=True)
    start, goal = (problem.feasible_grasps(T) for T in (task.start, task.goal))
    assert grid.regrasps(start, goal) == solve_sequence(problem, task.start, task.goal).num_regrasps
    assert grid.regrasps(start, np.zeros_like(goal)) is None
    assert grid.regrasps(grid.sets[0], grid.sets[0]) == 1
