"""The workcell: robot, end-effector, table, obstacles, workspace and clearances, from one TOML file."""

from regrasp_opt.scene.loading import WORKCELL_NAMES, load_workcell
from regrasp_opt.scene.workcell import Clearance, Table, Workcell, WorkspaceBounds

__all__ = ["WORKCELL_NAMES", "Clearance", "Table", "Workcell", "WorkspaceBounds", "load_workcell"]
