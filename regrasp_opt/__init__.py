"""Regrasp planning by continuous optimisation of learned pose connectivity, every plan verified by exact checks.

>>> from regrasp_opt import RegraspProblem, solve_sequence
>>> problem = RegraspProblem.load(object="bottle", workcell="nova2-w")

Names are imported when first used, so that importing the package is instant.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from regrasp_opt import notebook

if TYPE_CHECKING:
    from regrasp_opt.connectivity import CostOptions
    from regrasp_opt.errors import RegraspError
    from regrasp_opt.grasps import GraspSet
    from regrasp_opt.objects import load_object
    from regrasp_opt.planning import (
        Recipe,
        RegraspPlan,
        RegraspProblem,
        Status,
        Transition,
        solve_many,
        solve_sequence,
    )
    from regrasp_opt.planning.prepare import prepare
    from regrasp_opt.scene import load_workcell

_HOMES = {
    "CostOptions": "connectivity",
    "GraspSet": "grasps",
    "Recipe": "planning",
    "RegraspError": "errors",
    "RegraspPlan": "planning",
    "RegraspProblem": "planning",
    "Status": "planning",
    "Transition": "planning",
    "load_object": "objects",
    "load_workcell": "scene",
    "prepare": "planning.prepare",
    "solve_many": "planning",
    "solve_sequence": "planning",
}

__all__ = [
    "CostOptions",
    "GraspSet",
    "Recipe",
    "RegraspError",
    "RegraspPlan",
    "RegraspProblem",
    "Status",
    "Transition",
    "load_object",
    "load_workcell",
    "prepare",
    "solve_many",
    "solve_sequence",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'regrasp_opt' has no attribute '{name}'")
    return getattr(import_module(f"regrasp_opt.{_HOMES[name]}"), name)


def _page(shown: object) -> str:
    text: str = import_module("regrasp_opt.viz.page").page_of(shown)
    return text


notebook.drawing[:] = [_page]


def __dir__() -> list[str]:
    return __all__
