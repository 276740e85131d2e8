"""Which bodies of a robot may not come near each other, its tool and what that holds: one rule for checks and motions.

Links that one joint connects may touch, and those that the workcell names. What stands still is an obstacle, with the
clearances of one, but for the link in which the first joint turns: that is the arm's own. The tool may touch what turns
with the flange.
"""

from __future__ import annotations

from typing import NamedTuple

from regrasp_opt.scene.workcell import Workcell


class ArmPairs(NamedTuple):
    """Indices into the robot's collision bodies, and the clearances that they need [m].

    Attributes
    ----------
    links : list of (int, int, float)
        Two bodies of the robot; where one of them is among `Robot.obstacles`, it is the second.
    tool : list of (int, float)
        What the tool must keep away from.
    held : list of (int, float)
        What a held object must keep away from.
    """

    links: list[tuple[int, int, float]]
    tool: list[tuple[int, float]]
    held: list[tuple[int, float]]


def arm_pairs(workcell: Workcell) -> ArmPairs:
    """Return what must be apart among the bodies of the robot, its tool and a held object."""
    robot, clearance = workcell.arm.robot, workcell.clearance
    joints = [item.parentJoint for item in robot.collision.geometryObjects]
    others = [i for i, joint in enumerate(joints) if joint < robot.dof]
    links = [
        (j, i, clearance.arm)
        if i in robot.obstacles
        else (i, j, clearance.arm if j in robot.obstacles else clearance.self_collision)
        for i, j in robot.self_collision_pairs()
    ]
    tool = [(i, clearance.gripper if i in robot.obstacles else clearance.self_collision) for i in others]
    held = [(i, clearance.arm if joints[i] else clearance.gripper) for i in others]
    return ArmPairs(links, tool, held)
