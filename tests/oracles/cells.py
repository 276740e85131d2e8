"""The cells of the campaign: arms of other people, and arms of our own with posts, shelves and a torso in the URDF."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path

import numpy as np

from .files import read_cell
from .plans import PlanVerifier

H = np.pi / 2
UR = [
    ("0 0 0.0892", "0 0 0"),
    ("0 0 0", f"{H} 0 0"),
    ("-0.425 0 0", "0 0 0"),
    ("-0.39225 0 0.10915", "0 0 0"),
    ("0 -0.09465 0", f"{H} 0 0"),
    ("0 0.0823 0", f"{-H} 0 0"),
]
"""Origins of the joints of an arm like a UR5: xyz and rpy."""


def collision(shape, xyz="0 0 0", rpy="0 0 0"):
    return f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></collision>'


def rod(radius, length, xyz="0 0 0", rpy="0 0 0", kind="cylinder"):
    return collision(f'<{kind} radius="{radius}" length="{length}"/>', xyz, rpy)


def box(size, xyz="0 0 0"):
    return collision(f'<box size="{size}"/>', xyz)


def fixed(parent, name, xyz, bodies, kind="fixed"):
    """Return a link and the joint on which it stands; one that could turn is locked, as it leads to no tip."""
    more = '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="3"/>' if kind == "revolute" else ""
    return (
        f'<link name="{name}">{bodies}</link><joint name="to {name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="{xyz}"/>{more}</joint>'
    )


def arm(name, before, seat, after=""):
    """Return a URDF: links and joints `before`, an arm that turns in the link `seat`, and what else there is."""
    bodies = [
        rod(0.055, 0.14),
        rod(0.05, 0.425, "-0.2125 0 0.12", f"0 {H} 0") + rod(0.05, 0.13, "-0.425 0 0.08"),
        rod(0.04, 0.34, "-0.2 0 0.02", f"0 {H} 0", "capsule" if name == "shelf" else "cylinder"),
        rod(0.035, 0.09),
        rod(0.035, 0.09),
        rod(0.03, 0.04, "0 0 -0.02"),
    ]
    text = f'<robot name="{name}">{before}'
    for i, (xyz, rpy) in enumerate(UR, start=1):
        parent = seat if i == 1 else f"l{i - 1}"
        text += f'<link name="l{i}">{bodies[i - 1]}</link><joint name="j{i}" type="revolute"><parent link="{parent}"/>'
        text += f'<child link="l{i}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        text += '<limit lower="-3.14" upper="3.14" effort="9" velocity="3"/></joint>'
    return text + fixed("l6", "tool0", "0 0 0", "") + after + "</robot>"


def posts():
    """Return an arm between two posts that are fixed to the plate on which it stands."""
    before = f'<link name="plate">{rod(0.06, 0.02, "0 0 0.01")}</link>'
    after = fixed("plate", "left post", "0.15 0.33 0.3", rod(0.025, 0.6))
    return arm("posts", before, "plate", after + fixed("plate", "right post", "0.2 -0.33 0.3", rod(0.025, 0.6)))


def shelf():
    """Return an arm under a shelf that hangs on the same root, its second board over a part of the workspace."""
    boards = box("0.25 0.4 0.02", "0.6 0.35 0.42") + box("0.02 0.4 0.3", "0.72 0.35 0.27")
    before = '<link name="cell"/>' + fixed("cell", "foot", "0 0 0", rod(0.06, 0.02, "0 0 0.01"))
    return arm("shelf", before, "foot", fixed("cell", "shelf", "0 0 0", boards))


def torso():
    """Return the right arm of a torso; the left one's joints lead to no tip, so it stands still."""
    before = f'<link name="torso">{box("0.16 0.3 0.6", "-0.06 0.32 0.3")}</link>'
    before += fixed("torso", "head", "-0.06 0.32 0.72", collision('<sphere radius="0.1"/>'))
    before += fixed("torso", "right shoulder", "0 0 0.2", rod(0.06, 0.04, "0 0 0"))
    after = fixed("torso", "left arm", "0.02 0.55 0.5", rod(0.045, 0.3, "0 0 -0.15"), "revolute")
    after += fixed("left arm", "left hand", "0 0 -0.32", rod(0.04, 0.2, "0.12 0 0", f"0 {H} 0", "capsule"), "revolute")
    return arm("torso", before, "right shoulder", after)


FOREIGN = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "tool0", "x = [0.25, 0.6]\ny = [-0.35, 0.35]"),
    "z1": ("z1_description/urdf/z1.urdf", "gripperStator", "x = [0.25, 0.5]\ny = [-0.3, 0.3]"),
    "panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", "x = [0.3, 0.6]\ny = [-0.3, 0.3]"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "link_eef", "x = [0.3, 0.55]\ny = [-0.3, 0.3]"),
}
OWN = {"posts": posts, "shelf": shelf, "torso": torso}
OBSTACLES = """
[[obstacles]]
type = "box"
name = "crate"
position = [0.45, 0.42, 0.06]
size = [0.12, 0.1, 0.12]
"""


def write_cell(name, folder):
    """Write the cell `name` into `folder`, with a home that nothing collides at, and return the path of its TOML."""
    folder = Path(folder) / name
    path = folder / "cell.toml"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    if name in OWN:
        (folder / "arm.urdf").write_text(OWN[name](), encoding="utf-8")
        urdf, tip, space = str(folder / "arm.urdf"), "tool0", "x = [0.25, 0.6]\ny = [-0.25, 0.3]"
    else:
        robots = distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")
        urdf, tip, space = FOREIGN[name]
        urdf = str(Path(str(robots)) / urdf)

    def write(home):
        fresh = folder / "next.toml"
        fresh.write_text(
            f'schema = 1\n[robot]\nmodel = "{urdf}"\ntip = "{tip}"\nhome = {home}\n[end_effector]\nmodel = "w"\n'
            f"[table]\ncenter = [0.2, 0.0]\nsize = [1.4, 1.4]\n[workspace]\n{space}\n{OBSTACLES}",
            encoding="utf-8",
        )
        return fresh

    cell = read_cell({"source": str(write([])), "name": name})
    verifier = PlanVerifier(
        None, cell, (np.eye(4)[:, :3] * 0.01, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))
    )
    rng, away = np.random.default_rng(0), np.eye(4)
    away[:3, 3] = 9.0
    low, high = np.clip(cell.robot.limits.T, -2.0, 2.0)
    for _ in range(5000):
        home = np.round(rng.uniform(low, high), 2)
        if not verifier.collisions(home, away, cell.tool.max_opening, all_of_them=False):
            return write(home.tolist()).replace(path)
    raise ValueError(f"no home for '{name}' was found")
