"""Further plans that are really different: in supports, placements or grasps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from regrasp_opt.conventions import IntArray
from regrasp_opt.planning.plan import RegraspPlan
from regrasp_opt.planning.plan_data import shared_grasps

TRIES = 3
"""Plans with the same placements that are like earlier ones, after which others with these are passed over."""


class Alternatives:
    """Collects verified plans until there are enough; what a search asks whether it may end.

    Parameters
    ----------
    wanted : int
        Plans besides the first.
    accept : callable or None
        The caller's own condition on a plan.
    """

    def __init__(self, wanted: int, accept: Callable[[RegraspPlan], bool] | None) -> None:
        self._wanted, self._accept = wanted, accept
        self._found: list[RegraspPlan] = []
        self._alike: Counter[tuple[int, ...]] = Counter()

    def __call__(self, plan: RegraspPlan) -> bool:
        """Keep `plan` if it is unlike those before it; return whether there are enough."""
        if self._accept is None or self._accept(plan):
            if all(differ(plan, other) for other in self._found):
                self._found.append(plan)
            else:
                self._alike[tuple(plan.placements.tolist())] += 1
        return len(self._found) > self._wanted

    def tried(self, placements: IntArray) -> bool:
        """Return whether enough plans with these `placements` (N,) were like others that no more need be verified."""
        return self._alike[tuple(placements.tolist())] >= TRIES

    def deep_enough(self, num_regrasps: int) -> bool:
        """Return whether plans with so many regrasps are more than one longer than the first."""
        return bool(self._found) and num_regrasps > self._found[0].num_regrasps + 1

    def of(self, plan: RegraspPlan) -> RegraspPlan:
        """Return the first plan with the others as its alternatives, or `plan` where none was found."""
        return replace(self._found[0], alternatives=tuple(self._found[1:])) if self._found else plan


def differ(a: RegraspPlan, b: RegraspPlan) -> bool:
    """Return whether two plans differ in a placement or support, or share no grasp in some transition."""
    if a.placements.tolist() != b.placements.tolist():
        return True
    return any(not set(shared_grasps(a, i)) & set(shared_grasps(b, i)) for i in range(len(a.poses) - 1))
