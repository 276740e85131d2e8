"""Obstacles from scene files: our TOML, MoveIt's planning scenes (``.scene`` and YAML) and MuJoCo's MJCF.

What has no shape of ours is enclosed by a mesh that has no point inside it: spheres, capsules, ellipsoids and cones.
What cannot be an obstacle is left out with a warning that counts and names it; what is not understood is an error.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError, WorkcellError
from regrasp_opt.geometry.shapes import Shape
from regrasp_opt.io.mjcf import read_mjcf
from regrasp_opt.io.moveit_scenes import read_scene_text, read_scene_yaml
from regrasp_opt.scene import Workcell, load_obstacles


def read_obstacles(
    path: str | os.PathLike[str], workcell: Workcell | None = None, *, frame: str | None = None
) -> tuple[Shape, ...]:
    """Return the obstacles of a scene file, for `RegraspProblem.with_obstacles`; its suffix says how it is read.

    Parameters
    ----------
    path : path
        ``.toml`` with ``[[obstacles]]``; ``.scene`` or ``.yaml``, a planning scene of MoveIt's; ``.xml`` or ``.mjcf``,
        a model of MuJoCo's, of which the geoms that collide and do not move count (this needs MuJoCo).
    workcell : Workcell, optional
        Tells where the robot's root link is, whose name poses may be given in.
    frame : str, optional
        In which frame the poses of a ``.scene`` file or a model of MuJoCo's are, since these do not say: ``"world"``,
        which is the default, or the robot's root link. ``"world"`` is always our world, even if the root link has the
        same name; a message that says ``world`` means the root link then.

    Returns
    -------
    tuple of Shape
        In the world frame [m].

    Raises
    ------
    WorkcellError
        If the file cannot be read or has no obstacles, names a frame that is not known or a kind of shape that cannot
        be taken, or if MuJoCo is needed and not installed.
    OptionError
        If `frame` is not known, or the file names the frames itself.
    """
    path, world, root = Path(path), {"world": np.eye(4)}, dict[str, FloatArray]()
    if workcell is not None:
        root[str(workcell.arm.robot.model.frames[1].name)] = workcell.arm.T_world_base
    suffix, known = path.suffix.lower(), {**root, **world}
    if frame is not None and (frame not in known or suffix not in (".scene", ".xml", ".mjcf")):
        names = " and ".join(f"'{name}'" for name in known)
        raise OptionError(
            f"frame '{frame}' is not known or not needed for '{path}'; known: {names}, for .scene and MJCF"
        )
    if suffix == ".scene":
        shapes = read_scene_text(path)
    elif suffix in (".yaml", ".yml"):
        named = {**world, **root}  # a root link called world is what the message means
        shapes = read_scene_yaml(path, {**named, "": named["world"]})
    elif suffix in (".xml", ".mjcf"):
        shapes = read_mjcf(path)
    else:
        return load_obstacles(path)
    if not shapes:
        raise WorkcellError(f"{path} has no obstacles; omit it")
    return tuple(replace(shape, pose=known[frame or "world"] @ shape.pose) for shape in shapes)
