"""Recipes: which refiner, from which start points, accepted by which check.

``ipopt`` starts from samples of a short annealed Langevin run, which begins at the best lattice chains;
``langevin-ipopt`` from the best of a Langevin run that begins anywhere. ``langevin`` is the paper's optimiser with hard
checks, ``paper`` its Algorithms 1 and 2 as they stand, which accept by the threshold `h` alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import InitVar, dataclass, replace
from typing import Any, Literal

import numpy as np

from regrasp_opt.connectivity import SequenceObjective
from regrasp_opt.errors import OptionError, UnknownNameError
from regrasp_opt.solvers import (
    Candidates,
    LangevinRefiner,
    LatticeRefiner,
    NlpRefiner,
    PoseLattice,
    Refiner,
    lattice_starts,
    random_starts,
)

FIRST_STARTS, REFINED_STARTS = 2, 6
"""Start points that are refined first, and in all if none of those is verified, for each N."""
VERIFIED_CHAINS = 400
"""Lattice chains that are verified unrefined for each N if no refined one was."""
LANGEVIN_SAMPLES = 256
"""Chains of the short Langevin run that makes start points."""


@dataclass(frozen=True)
class Recipe:
    """A refiner, where its start points come from, and how a candidate is accepted.

    Attributes
    ----------
    refiner : Refiner
    starts : {"lattice", "langevin", "random"}
        Chains of lattice poses, the most promising first; the best of a short Langevin run; or random sequences
        (Alg. 1, line 2).
    batches : tuple of int
        How many start points are refined and checked at a time, until a candidate is accepted.
    verified : int
        Candidates of a batch that are checked at most, the cheapest first (``K_top`` of Alg. 2).
    fallback : int
        Lattice chains that are checked as they are, if no refined candidate was accepted.
    warm : LangevinRefiner, optional
        Improves all start points together, before any of them is refined.
    check : {"verification", "threshold"}
        Accept the first candidate that is verified; or, as the paper does, the cheapest that passes the energy
        threshold `h` (Alg. 2), which is then verified once: if that fails there is no plan.
    knowledge : {"exact", "learned"}
        What the cost knows exactly: the grasps at both ends and those that table, object and obstacles rule out, or
        nothing, as in the paper, whose energies are all learned.
    """

    refiner: Refiner
    starts: Literal["lattice", "langevin", "random"] = "lattice"
    batches: tuple[int, ...] = (FIRST_STARTS, REFINED_STARTS - FIRST_STARTS)
    verified: int = REFINED_STARTS
    fallback: int = VERIFIED_CHAINS
    check: Literal["verification", "threshold"] = "verification"
    knowledge: Literal["exact", "learned"] = "exact"
    warm: LangevinRefiner | None = None
    proved: InitVar[int | None] = None  # the name of `verified` until 0.1; goes with 0.3

    def __post_init__(self, proved: int | None) -> None:
        if proved is not None:
            object.__setattr__(self, "verified", proved)
        if not self.batches or min(self.batches) < 1 or self.verified < 1 or self.fallback < 0:
            raise OptionError("a recipe needs batches and verified of at least 1, and a fallback of at least 0")

    @property
    def stages(self) -> list[str]:
        """The stages by name: where sequences begin, what warms them up, and what refines them."""
        return [self.starts, *([] if self.warm is None else [self.warm.name]), self.refiner.name]

    def start_points(
        self,
        lattice: Callable[[], PoseLattice],
        objective: SequenceObjective,
        num_regrasps: int,
        rng: np.random.Generator,
    ) -> Candidates:
        """Return start points for all batches.

        Parameters
        ----------
        lattice : callable
            Returns the lattice of the problem; called only if `starts` is ``"lattice"``.
        objective : SequenceObjective
        num_regrasps : int
            N, the number of intermediate poses.
        rng : Generator
        """
        wanted = sum(self.batches)
        if self.starts == "lattice":
            points = lattice_starts(lattice(), objective, num_regrasps, wanted, rng)
            if not isinstance(self.refiner, LatticeRefiner):  # the lattice knows the costs but roughly
                points = replace(points, cost=objective.cost(points.placements, points.xi))
        elif self.starts == "random":
            points = random_starts(objective, num_regrasps, wanted, rng)
        else:
            samples = random_starts(objective, num_regrasps, max(wanted, LANGEVIN_SAMPLES), rng)
            points = LangevinRefiner().refine(objective, samples, rng).candidates.best(wanted)
        if self.warm is None or not len(points):
            return points
        return self.warm.refine(objective, points, rng).candidates.best(len(points))


def paper_recipe(k_top: int) -> Recipe:
    """Return the paper's Algorithms 1 and 2, with its ``K_top``."""
    return Recipe(
        LangevinRefiner(keep_best=False),
        starts="random",
        batches=(1000,),
        verified=k_top,
        fallback=0,
        check="threshold",
        knowledge="learned",
    )


ANNEALING = LangevinRefiner(iterations=10, eta=0.1, tau=0.01, anneal=True, device="numpy")
"""The short run that warms up the start points of Ipopt."""

RECIPES: dict[str, Callable[[], Recipe]] = {
    "ipopt": lambda: Recipe(NlpRefiner(), batches=(1, 1, 6), verified=8, warm=ANNEALING),
    "langevin-ipopt": lambda: Recipe(NlpRefiner(), starts="langevin", fallback=0),
    "lattice": lambda: Recipe(LatticeRefiner(), batches=(VERIFIED_CHAINS,), verified=VERIFIED_CHAINS, fallback=0),
    "langevin": lambda: Recipe(LangevinRefiner(), starts="random", batches=(1000,), verified=50, fallback=0),
    "paper": lambda: paper_recipe(50),
}


EXACT = "exact"
"""The name of planning without an energy (`regrasp_opt.planning.exact`), which has no recipe."""

REFINERS = (*RECIPES, EXACT)
"""The names that `solve_sequence` takes."""


def as_recipe(refiner: Any) -> Recipe:
    """Return the recipe that a name, a refiner or a recipe stands for.

    Raises
    ------
    UnknownNameError, OptionError
        For an unknown name, or something that has no method ``refine``.
    """
    if isinstance(refiner, Recipe):
        return refiner
    if isinstance(refiner, str):
        if refiner not in RECIPES:
            raise UnknownNameError("refiner", refiner, REFINERS)
        return RECIPES[refiner]()
    if not callable(getattr(refiner, "refine", None)):
        raise OptionError(f"the refiner has no method 'refine'; give a Refiner or one of {', '.join(REFINERS)}")
    return Recipe(refiner)
