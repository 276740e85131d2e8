"""Pictures of plans: a page, a live viewer, plots."""

from regrasp_opt.viz.page import write_plan_page

__all__ = ["write_plan_page"]
