"""`J_seq` as a nonlinear program over ``xi``, solved by Ipopt or another CasADi plugin.

The first layers at the chosen placements and the energies at both ends are parameters, so one solver object serves
all problems with the same energy, N and number of grasps; objects are kept for as long as the energy lives.

Grasps that cannot matter are left out, because that is where most of the work goes: see `_active_grasps`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from regrasp_opt.connectivity import BLOCKED, SequenceObjective
from regrasp_opt.connectivity.casadi_costs import layers_parameter
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.solvers.base import Candidates, Refinement, keep_better
from regrasp_opt.solvers.nlp_solver import lock
from regrasp_opt.solvers.options import ProgramOptions
from regrasp_opt.solvers.program import SequenceProgram

ACTIVE_SIZES = (8, 16, 24, 32, 48, 64, 96, 128, 192)
"""Numbers of grasps for which solvers are built; more than the last takes all grasps."""

_programs: WeakKeyDictionary[GraspEnergy, dict[Any, SequenceProgram]] = WeakKeyDictionary()


@dataclass(frozen=True)
class NlpRefiner:
    """Refine each start by one local solve within the workspace bounds; keep the start where that is not better.

    Attributes
    ----------
    program : ProgramOptions
        The solver plugin and its settings.
    """

    program: ProgramOptions = field(default_factory=ProgramOptions)

    @property
    def name(self) -> str:
        """Short name, for reports."""
        return self.program.plugin if self.program.hessian == "exact" else f"{self.program.plugin}-lbfgs"

    def recording(self) -> NlpRefiner:
        """Return this refiner, but keeping the poses of every iteration."""
        return replace(self, program=replace(self.program, record=True))

    def refine(self, objective: SequenceObjective, starts: Candidates, rng: np.random.Generator) -> Refinement:
        """Return the refined candidates; the stats count solves, converged ones, improved ones and iterations."""
        solves, grasps = [], []
        with lock:
            for placements, xi in zip(starts.placements, starts.xi, strict=True):
                blocked = objective.ruled_out(placements, xi)
                ids, ends = _active_grasps(objective, blocked)
                program = self._program(objective, len(xi), len(ids))
                planar = objective.placements[placements]
                layers = layers_parameter(objective.energy, planar, ids)
                solves.append(program.solve(xi, layers, blocked[:, ids], ends, (planar.low, planar.high)))
                grasps.append(len(ids))
        xi = np.array([solve.xi for solve in solves]).reshape(starts.xi.shape)
        status = tuple(solve.status for solve in solves)
        stats = {
            "solves": len(solves),
            "grasps": max(grasps, default=0),
            "converged": sum(solve.converged for solve in solves),
            "improved": sum(solve.improved for solve in solves),
            "iterations": [solve.iterations for solve in solves],
            "evaluations": sum(solve.evaluations for solve in solves),
            "statuses": {name: status.count(name) for name in sorted(set(status))},
        }
        refined = keep_better(objective, starts, objective.placements.wrapped(starts.placements, xi))
        paths = tuple(solve.path for solve in solves) if self.program.record else ()
        return Refinement(refined, status, tuple(solve.trace for solve in solves), stats, paths)

    def _program(self, objective: SequenceObjective, num_regrasps: int, grasps: int) -> SequenceProgram:
        known = _programs.setdefault(objective.energy, {})
        key = (self.program, objective.options, num_regrasps, grasps)
        if key not in known:
            expressions = CasadiEnergy(objective.energy.model, grasps)
            known[key] = SequenceProgram(expressions, objective.options, num_regrasps, self.program)
        return known[key]


def useful_grasps_near(objective: SequenceObjective, blocked: BoolArray) -> IntArray:
    """Return the grasps (A,) that can matter from one start, where those `blocked` (N, G) are ruled out.

    What is ruled out at every intermediate pose is left out.
    """
    useful = objective.useful_grasps(len(blocked))
    return useful[~blocked[:, useful].all(axis=0)]


def _active_grasps(objective: SequenceObjective, blocked: BoolArray) -> tuple[IntArray, FloatArray]:
    """Return the grasps (A,) to solve with from one start, and their energies (A, 2) at both ends.

    A is rounded up to one of a few sizes, so that solvers can be kept; what fills it up is blocked at both ends.
    """
    ends = np.stack([objective.start_energy, objective.goal_energy], axis=1)
    useful = useful_grasps_near(objective, blocked)
    others = np.setdiff1d(np.arange(len(ends)), useful)
    size = next((n for n in ACTIVE_SIZES if n >= len(useful)), len(ends))
    ends[others] = BLOCKED
    ids = np.concatenate([useful, others])[:size]
    return ids, ends[ids]
