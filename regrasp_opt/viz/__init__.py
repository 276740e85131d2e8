"""Pictures of plans: a page and plots."""

from regrasp_opt.viz.candidates import CandidateTrace, trace_candidates
from regrasp_opt.viz.page import write_plan_page, write_problem_page
from regrasp_opt.viz.track import Track, track_of

__all__ = ["CandidateTrace", "Track", "trace_candidates", "track_of", "write_plan_page", "write_problem_page"]
