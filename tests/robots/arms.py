"""Robots that the tests of this folder share."""

from importlib.metadata import distribution
from pathlib import Path

FOREIGN = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
UR5 = FOREIGN / "ur_description/urdf/ur5_robot.urdf"
UR10 = FOREIGN / "ur_description/urdf/ur10_robot.urdf"
PANDA = FOREIGN / "panda_description/urdf/panda.urdf"
HOME_PANDA = (0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.7)


def arm_urdf(joints, extra="", geometry=""):
    """Return a URDF of links link0, link1, ... with one joint (type, xyz, rpy, axis, limits) per entry."""
    text = [f"<robot name='arm'><link name='link0'>{geometry}</link>"]
    for i, (kind, xyz, rpy, axis, limits) in enumerate(joints):
        limit = ""
        if limits is not None:
            limit = f"<limit lower='{limits[0]}' upper='{limits[1]}' velocity='1' effort='1'/>"
        text.append(
            f"<link name='link{i + 1}'/><joint name='j{i + 1}' type='{kind}'><parent link='link{i}'/>"
            f"<child link='link{i + 1}'/><origin xyz='{xyz}' rpy='{rpy}'/><axis xyz='{axis}'/>{limit}</joint>"
        )
    return "".join([*text, extra, "</robot>"])


MIXED = [
    ("revolute", "0.1 0 0.3", "0.2 0 0.4", "0 1 0", (-2, 2)),
    ("fixed", "0 0.2 0", "0 0.3 0", "0 0 1", None),
    ("prismatic", "0 0 0.1", "0.5 0 0", "1 0 0", (-0.2, 0.3)),
    ("continuous", "0.2 0.1 0", "0 0.1 0.9", "0 0 1", None),
    ("revolute", "0 0 0.25", "1 0.3 0", "0.6 0 0.8", (-1, 3)),
    ("fixed", "0.05 0 0.1", "0 0 1", "0 0 1", None),
]
"""Every kind of joint, slanted axes and offsets."""

TURN = (-3.1, 3.1)
GENERAL_SIX = [
    ("revolute", "0 0 0.3", "0 0.3 0.2", "0 0 1", TURN),
    ("revolute", "0.1 0.05 0.1", "1.2 0 0.4", "0 0 1", TURN),
    ("revolute", "0.3 0 0.07", "0.3 0.5 0", "0 0 1", TURN),
    ("revolute", "0.25 0.1 0", "0.9 0.2 0.7", "0 0 1", TURN),
    ("revolute", "0.05 0 0.2", "1.1 0.4 0", "0 0 1", TURN),
    ("revolute", "0.06 0.03 0.1", "0.8 0.6 0.1", "0 0 1", TURN),
]
"""Six joints of which no axes are parallel or meet, so that no decomposition is known."""
