"""End-effectors: parallel grippers and suction cups as data (TCP offset, stroke, collision bodies).

The six built-in ones live in ``data/end_effectors``; any other is a TOML file of the same form.
"""

from regrasp_opt.end_effectors.loading import END_EFFECTOR_NAMES, load_end_effector
from regrasp_opt.end_effectors.model import EndEffector

__all__ = ["END_EFFECTOR_NAMES", "EndEffector", "load_end_effector"]
