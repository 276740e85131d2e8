"""The scene: arm, supports, obstacles, workspace and clearances of one TOML file, and the bodies that can collide."""

from regrasp_opt.scene.arm import Arm
from regrasp_opt.scene.loading import (
    FURTHER_WORKCELL_NAMES,
    WORKCELL_NAMES,
    as_obstacles,
    load_obstacles,
    load_workcell,
)
from regrasp_opt.scene.support import Fixture, HeldPose, Support, WorkspaceBounds
from regrasp_opt.scene.workcell import Clearance, Workcell

__all__ = [
    "FURTHER_WORKCELL_NAMES",
    "WORKCELL_NAMES",
    "Arm",
    "Clearance",
    "Fixture",
    "HeldPose",
    "Support",
    "Workcell",
    "WorkspaceBounds",
    "as_obstacles",
    "load_obstacles",
    "load_workcell",
]
