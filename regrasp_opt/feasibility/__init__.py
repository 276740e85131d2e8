"""The exact check of one (pose, grasp) pair and of batches, and labelled data sets made with it."""

from regrasp_opt.feasibility.checker import Branches, FeasibilityChecker
from regrasp_opt.feasibility.scene import CollisionScene

__all__ = ["Branches", "CollisionScene", "FeasibilityChecker"]
