"""Differentiable connectivity of poses: `Q_pair` (Eq. 4), `J_seq` (Eq. 5) and the paper's variants."""

from regrasp_opt.connectivity.costs import CostOptions, pair_score, sequence_cost, truncated_pair_score
from regrasp_opt.connectivity.objective import BLOCKED, Rule, SequenceObjective, TableRule, block, exact_energy

__all__ = [
    "BLOCKED",
    "CostOptions",
    "Rule",
    "SequenceObjective",
    "TableRule",
    "block",
    "exact_energy",
    "pair_score",
    "sequence_cost",
    "truncated_pair_score",
]
