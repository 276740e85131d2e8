"""A refiner of your own in a few lines: coordinate descent, compared with the built-in ones.

Anything with a `name` and a method `refine` can be passed to `solve_sequence`, alone or in a `Recipe`, which says how
many start points it gets: `python examples/05_new_refiner.py`.
"""

from dataclasses import dataclass

import numpy as np

from regrasp_opt import Recipe, RegraspProblem, solve_sequence
from regrasp_opt.solvers import Candidates, Refinement


@dataclass(frozen=True)
class CoordinateDescent:
    """Step along one coordinate of one pose at a time, both ways; halve the steps after each round."""

    rounds: int = 6
    name: str = "coordinate-descent"

    def refine(self, objective, starts, rng):
        low, high = objective.bounds
        xi, cost = starts.xi.copy(), objective.cost(starts.placements, starts.xi)
        trace = [cost.copy()]
        for k in range(self.rounds):
            steps = np.array([0.06, 0.06, 0.5]) / 2**k
            for pose, axis in np.ndindex(xi.shape[1:]):
                for sign in (1, -1):
                    trial = xi.copy()
                    trial[:, pose, axis] += sign * steps[axis]
                    trial[..., :2] = np.clip(trial[..., :2], low, high)
                    trial_cost = objective.cost(starts.placements, trial)
                    better = trial_cost < cost
                    xi[better], cost[better] = trial[better], trial_cost[better]
            trace.append(cost.copy())
        refined = Candidates(starts.placements, xi, cost)
        return Refinement(refined, ("finished",) * len(starts), tuple(np.transpose(trace)), {"rounds": self.rounds})


def main() -> None:
    problem = RegraspProblem.load("bottle", "nova2-w")
    start, goal = problem.pose(2, -0.25, 0.40, 0.5), problem.pose(4, 0.28, 0.38, 2.1)
    print(f"{'refiner':20}{'status':10}{'regrasps':>9}{'J_seq':>9}")
    own = CoordinateDescent()
    for name, refiner in {"lattice": "lattice", own.name: Recipe(own, batches=(20,)), "ipopt": "ipopt"}.items():
        plan = solve_sequence(problem, start, goal, refiner)
        print(f"{name:20}{plan.status.name:10}{plan.num_regrasps:>9}{plan.cost:>9.3f}")


if __name__ == "__main__":
    main()
