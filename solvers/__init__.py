"""Refiners: what turns a batch of candidate pose sequences into a cheaper one.

`NlpRefiner` (Ipopt and other CasADi plugins), `LangevinRefiner` (Eq. 7) and `LatticeRefiner` share the `Refiner`
protocol: a batch in, a batch out. This layer knows poses, energies and costs; it never sees a robot or a mesh.
"""

from regrasp_opt.solvers.base import Candidates, Refinement, Refiner, random_starts
from regrasp_opt.solvers.langevin import LangevinRefiner
from regrasp_opt.solvers.lattice import LatticeRefiner, PoseLattice, lattice_starts
from regrasp_opt.solvers.nlp import NlpRefiner
from regrasp_opt.solvers.nlp_solver import NlpSolution, NlpSolver
from regrasp_opt.solvers.options import ProgramOptions
from regrasp_opt.solvers.recording import RecordedBatch, RecordingRefiner
from regrasp_opt.solvers.regrasp_nlp import OptiTerms, RegraspNLP

__all__ = [
    "Candidates",
    "LangevinRefiner",
    "LatticeRefiner",
    "NlpRefiner",
    "NlpSolution",
    "NlpSolver",
    "OptiTerms",
    "PoseLattice",
    "ProgramOptions",
    "RecordedBatch",
    "RecordingRefiner",
    "Refinement",
    "Refiner",
    "RegraspNLP",
    "lattice_starts",
    "random_starts",
]
