"""Which CasADi plugin solves a program, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca

from regrasp_opt.errors import OptionError

Hessian = Literal["exact", "limited-memory"]

FROM_A_SAMPLE = (("mu_init", 1e-4), ("bound_push", 1e-8), ("bound_frac", 1e-8), ("bound_relax_factor", 0.0))
"""Ipopt's options for a good start: begin with a small barrier and do not push it off its bounds."""


@dataclass(frozen=True)
class ProgramOptions:
    """How the program is solved.

    Attributes
    ----------
    plugin : str
        Any CasADi NLP plugin, for example ``ipopt`` or ``sqpmethod``.
    hessian : {"exact", "limited-memory"}
        Exact second derivatives, or a quasi-Newton approximation.
    max_iterations : int
    tolerance : float
        On the first-order conditions.
    pair_limit : float, optional
        Largest ``Q_pair`` allowed between neighbours; None leaves the pairs to the cost. A `RegraspNLP` is given its
        constraints instead.
    record : bool
        Keep the variables at every iteration, in `NlpSolution.path`.
    ipopt : tuple of (str, value)
        Further options of Ipopt; they come last.
    """

    plugin: str = "ipopt"
    hessian: Hessian = "exact"
    max_iterations: int = 100
    tolerance: float = 1e-5
    pair_limit: float | None = None
    record: bool = False
    ipopt: tuple[tuple[str, Any], ...] = FROM_A_SAMPLE

    def __post_init__(self) -> None:
        if not ca.has_nlpsol(self.plugin):
            raise OptionError(f"CasADi has no NLP plugin '{self.plugin}'; use for example ipopt or sqpmethod")
        if self.hessian not in ("exact", "limited-memory"):
            raise OptionError(f"hessian '{self.hessian}' is unknown; use exact or limited-memory")
        if self.max_iterations < 1:
            raise OptionError(f"max_iterations is {self.max_iterations}; give at least 1")
        if not self.tolerance > 0:
            raise OptionError(f"tolerance is {self.tolerance}; give a positive number")


def plugin_options(settings: ProgramOptions) -> dict[str, Any]:
    """Return the options of `settings` as their CasADi plugin names them."""
    if settings.plugin == "ipopt":
        return {
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": settings.max_iterations,
                "tol": settings.tolerance,
                "hessian_approximation": settings.hessian,
                **dict(settings.ipopt),
            }
        }
    if settings.plugin == "sqpmethod":
        return {
            "max_iter": settings.max_iterations,
            "tol_du": settings.tolerance,
            "hessian_approximation": settings.hessian,
            "qpsol": "qrqp",
            "convexify_strategy": "regularize",
            "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
            "print_header": False,
            "print_iteration": False,
            "print_status": False,
            "error_on_fail": False,
        }
    return {}
