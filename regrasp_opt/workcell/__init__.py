"""The workcell: robot, end-effector, table, obstacles, workspace and clearances, from one TOML file."""

from regrasp_opt.workcell.loading import WORKCELL_NAMES, load_workcell
from regrasp_opt.workcell.model import Bounds, Clearance, Table, Workcell

__all__ = ["WORKCELL_NAMES", "Bounds", "Clearance", "Table", "Workcell", "load_workcell"]
