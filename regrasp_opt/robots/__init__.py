"""Robots: any serial arm from its URDF, with limits, forward and all-branch inverse kinematics, and bodies.

The Nova2 is built in; some others are known by name, too. Read `Robot` first; `load_robot` makes one.
"""

from regrasp_opt.robots.ik import IkSolutions, InverseKinematics
from regrasp_opt.robots.loading import EXAMPLE_ROBOT_NAMES, ROBOT_NAMES, load_robot
from regrasp_opt.robots.robot import Robot

__all__ = ["EXAMPLE_ROBOT_NAMES", "ROBOT_NAMES", "IkSolutions", "InverseKinematics", "Robot", "load_robot"]
