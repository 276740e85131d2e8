"""Pictures of plans."""

from regrasp_opt.viz.plan_page import write_plan_page

__all__ = ["write_plan_page"]
