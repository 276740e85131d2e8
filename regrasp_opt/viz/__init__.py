"""Pictures of plans: a page, a live viewer, plots."""

from regrasp_opt.viz.page import write_plan_page
from regrasp_opt.viz.track import Track, track_of

__all__ = ["Track", "track_of", "write_plan_page"]
