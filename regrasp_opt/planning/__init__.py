"""From a problem to a verified plan: `RegraspProblem`, `solve_sequence`, `RegraspPlan` and `prepare`."""

from regrasp_opt.planning.many import solve_many
from regrasp_opt.planning.plan import RegraspPlan
from regrasp_opt.planning.plan_data import Status, Transition
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.planning.recipes import Recipe
from regrasp_opt.planning.search import solve_sequence

__all__ = ["Recipe", "RegraspPlan", "RegraspProblem", "Status", "Transition", "solve_many", "solve_sequence"]
