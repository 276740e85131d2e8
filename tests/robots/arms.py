"""Robots that the tests of this folder share."""

from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pinocchio as pin

from regrasp_opt.robots.kinematics import SerialChain

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

H = np.pi / 2
INNER_PARALLEL = [
    ("revolute", "0 0 0.3", "0 0 0", "0 0 1", (-6.28, 6.28)),
    ("revolute", "0.25 0 0", "0 0 0", "0 0 1", (-6.28, 6.28)),
    ("revolute", "0.1 0 0", f"{-H} 0 0", "0 0 1", (-6.28, 6.28)),
    ("revolute", "0.2 0 0", "0 0 0", "0 0 1", (-6.28, 6.28)),
    ("revolute", "0.2 0 0", "0 0 0", "0 0 1", (-6.28, 6.28)),
    ("revolute", "0.08 0 0", f"0 {H} 0", "0 0 1", (-6.28, 6.28)),
    ("fixed", "0 0 0.05", "0 0 0", "0 0 1", None),
]
"""Axes 1 and 2 are parallel, and 3, 4 and 5; at zero all meet at right angles."""

FAMILIES = {
    "ur": (
        "0 0 1, 0 1 0, 0 1 0, 0 1 0, -0 -0 -1, 0 1 0",
        "0 0 0.089, 0 0.136 0, 0.425 -0.12 0, 0.392 0 0, 0 0.093 0, 0 0 -0.095, 0 0.08 0",
    ),
    "puma": (
        "0 0 1, 0 1 0, 0 1 0, 0 0 1, 0 1 0, 0 0 1",
        "0 0 0.67, 0 0.24 0, 0.43 -0.09 0, -0.02 0 0.43, 0 0 0, 0 0 0, 0 0 0.06",
    ),
    "kuka": (
        "0 0 1, 0 1 0, 0 1 0, 1 0 0, 0 1 0, 1 0 0",
        "0 0 0.4, 0.18 0 0.1, 0 0 0.6, 0.3 0 0.12, 0.32 0 0, 0 0 0, 0.1 0 0",
    ),
    "first two parallel": (
        "0 0 1, 0 0 1, 0 1 0, 0 0 1, 0 1 0, 0 0 1",
        "0 0 0.4, 0.3 0 0, 0.3 0 0.1, 0.1 0 0.3, 0 0 0, 0 0 0, 0 0 0.1",
    ),
    "first two meet": (
        "0 0 1, 0 1 0, 1 0 0, 0 0 1, 0 1 0, 0 0 1",
        "0 0 0.4, 0 0 0, 0.3 0.1 0.2, 0.1 0.05 0.3, 0 0 0, 0 0 0, 0 0 0.1",
    ),
    "second two meet": (
        "0 0 1, 0 1 0, 1 0 0, 0 0 1, 0 1 0, 0 0 1",
        "0 0 0.4, 0.1 0.2 0.1, 0.3 0 0, 0.1 0.15 0.3, 0 0 0, 0 0 0, 0 0 0.1",
    ),
    "wrist only": (
        "0 0 1, 0 1 0, 1 0.333333 0, 0 0 1, 0 1 0, 0 0 1",
        "0 0 0.4, 0.1 0.1 0.1, 0.3 0.1 0.2, 0.1 0.15 0.3, 0 0 0, 0 0 0, 0 0 0.1",
    ),
    "wrist at the base": (
        "0 0 1, 0 1 0, 1 0 0, 0 1 0, 0 1 0, 0 0 1",
        "0 0 0.3, 0 0 0, 0 0 0, 0.4 0 0.05, 0.3 0.05 0, 0.2 0 0, 0.05 0 0",
    ),
    "three parallel first": (
        "0 0 1, 0 0 1, 0 0 1, 1 0 0, 0 1 0, 1 0 0",
        "0 0 0.3, 0.3 0 0, 0.3 0 0.1, 0.2 0.05 0, 0.1 0 0.1, 0 0 0, 0.1 0 0",
    ),
    "three parallel last": (
        "1 0 0, 0 1 0, 1 0 0, 0 0 1, 0 0 1, 0 0 1",
        "0 0 0.3, 0 0 0, 0.1 0.05 0.1, 0.3 0.05 0, 0.3 0.05 0, 0.2 0 0, 0.05 0 0.1",
    ),
    "inner parallel": (
        "0 0 1, 0 1 0, 0 1 0, 0 1 0, 1 0 0, 0 1 1",
        "0 0 0.3, 0.1 0.1 0, 0.4 0 0.1, 0.3 0.05 0, 0.1 0 0.1, 0.05 0.1 0.07, 0.1 0 0",
    ),
    "inner parallel, last two parallel": (
        "0 0 1, 0 1 0, 0 1 0, 0 1 0, 1 0 0, 1 0 0",
        "0 0 0.3, 0.1 0.1 0, 0.4 0 0.1, 0.3 0.05 0, 0.1 0 0.1, 0.05 0.1 0.07, 0.1 0 0",
    ),
}
"""Arms of the families that EAIK knows: axes at zero, and the steps [m] from the base over the axes to the tip."""


def chain_of(axes, steps):
    """Return the chain of six turning joints with these axes and steps, written as in `FAMILIES`."""
    axes, steps = (np.array([row.split() for row in text.split(",")], dtype=float) for text in (axes, steps))
    placements, tip = np.eye(4)[None].repeat(6, 0), np.eye(4)
    placements[:, :3, 3], tip[:3, 3] = steps[:6], steps[6]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return SerialChain(placements, axes, np.zeros(6, dtype=bool), tip)


def calibrated(chain, size, seed, joints=range(6)):
    """Return `chain` with the frames of `joints` turned by `size` [rad] and moved by `size` [m], at random."""
    rng, placements = np.random.default_rng(seed), chain.placements.copy()
    for joint in joints:
        turn, move = (size * v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        placements[joint] = placements[joint] @ pin.exp6(np.concatenate([move, turn])).homogeneous
    return SerialChain(placements, chain.axes, chain.prismatic, chain.tip)
