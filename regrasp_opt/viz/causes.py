"""Why grasps fail at the poses of a plan, as colours: one for each cause, and one for grasps that are feasible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import IntArray
from regrasp_opt.feasibility.diagnosis import Cause, diagnose
from regrasp_opt.planning import RegraspPlan

FEASIBLE = "#009e73"
CAUSE_COLOURS = {
    Cause.OBJECT: "#1b1f24",
    Cause.OUT_OF_REACH: "#7a828c",
    Cause.GRIPPER_IN_TABLE: "#8a5a2b",
    Cause.JOINT_LIMIT: "#6a3d9a",
    Cause.NO_CONFIGURATION: "#b39ddb",
    Cause.GRIPPER_IN_OBSTACLE: "#d7301f",
    Cause.ARM_IN_TABLE: "#d8b37a",
    Cause.ARM_IN_OBJECT: "#f0c419",
    Cause.ARM_IN_OBSTACLE: "#f78fb3",
    Cause.SELF_COLLISION: "#1f78b4",
}
NAMED = 3
"""Bodies of one cause that the legend names."""


class GraspCauses(NamedTuple):
    """Why grasps fail at one pose.

    Attributes
    ----------
    legend : tuple of (name, colour, count)
        Feasible grasps first, then each cause that occurs.
    of_grasp : (G,) int
        Which of these each grasp belongs to.
    """

    legend: tuple[tuple[str, str, int], ...]
    of_grasp: IntArray


def grasp_causes(plan: RegraspPlan) -> tuple[GraspCauses, ...]:
    """Return the causes at each pose of `plan`."""
    found = []
    for T in plan.poses:
        failures = diagnose(plan.problem.checker, T)
        causes = [failure and failure.cause for failure in failures]
        known = [None, *(cause for cause in Cause if cause in causes)]
        legend = []
        for cause in known:
            bodies = sorted({" and ".join(f.bodies) for f in failures if f and f.cause is cause and f.bodies})
            names = ", ".join(bodies[:NAMED]) + (", ..." if len(bodies) > NAMED else "")
            text = "feasible" if cause is None else f"{cause.value} {names}".strip()
            legend.append((text, FEASIBLE if cause is None else CAUSE_COLOURS[cause], causes.count(cause)))
        found.append(GraspCauses(tuple(legend), np.array([known.index(cause) for cause in causes])))
    return tuple(found)
