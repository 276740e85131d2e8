"""Obstacles from MuJoCo's models (MJCF): read by MuJoCo itself, which knows defaults, classes, angles and includes.

What collides and stands still is an obstacle: geoms of bodies without a joint on the way to the world. A mesh is taken
as it is, where MuJoCo takes its convex hull.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from regrasp_opt.conventions import translation
from regrasp_opt.errors import WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.io.scene_shapes import ENCLOSED, ball_around, say_left_out


def read_mjcf(path: Path) -> list[Shape]:
    """Return the geoms of a model that collide and do not move, in the world frame.

    Raises
    ------
    WorkcellError
        If MuJoCo is not installed or refuses the model, or a geom is a height field or a distance function, or is
        nowhere.
    """
    try:
        import mujoco
    except ImportError as error:
        raise WorkcellError(f"reading {path} needs the package mujoco; install regrasp-opt[formats]") from error
    warn = mujoco.get_mju_user_warning()
    try:
        if "<mujoco" not in path.read_text(encoding="utf-8"):
            raise WorkcellError(f"scene {path} is not a model of MuJoCo's: it has no <mujoco>; give an MJCF file")
        mujoco.set_mju_user_warning(lambda text: None)  # or a warning leaves a file in the current folder
        model = mujoco.MjModel.from_xml_path(str(path))
    except (OSError, ValueError) as error:
        raise WorkcellError(f"scene {path} cannot be read: {' '.join(str(error).split())}") from error
    finally:
        mujoco.set_mju_user_warning(warn)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    kinds = mujoco.mjtGeom
    still = model.body_weldid[model.geom_bodyid] == 0
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    collides[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
    names = [model.geom(i).name or f"{model.body(model.geom_bodyid[i]).name}-{i}" for i in range(model.ngeom)]
    shapes: list[Shape] = []
    planes, enclosed = [], []
    for i in np.flatnonzero(still & collides).tolist():
        pose = translation(*data.geom_xpos[i])
        pose[:3, :3] = data.geom_xmat[i].reshape(3, 3)
        if not np.isfinite(pose).all():
            raise WorkcellError(f"scene {path}: the pose of geom '{names[i]}' holds NaN or infinity; give numbers")
        kind, size, name = kinds(int(model.geom_type[i])), np.array(model.geom_size[i]), names[i]
        if kind == kinds.mjGEOM_PLANE:
            planes.append(name)
        elif kind == kinds.mjGEOM_BOX:
            shapes.append(Box(name, 2 * size, pose))
        elif kind == kinds.mjGEOM_CYLINDER:
            shapes.append(Cylinder(name, float(size[0]), 2 * float(size[1]), pose))
        elif kind == kinds.mjGEOM_MESH:
            mesh = model.mesh(model.geom_dataid[i])
            vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]].astype(np.float64)
            faces = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]].astype(np.int64)
            shapes.append(Mesh(name, vertices, faces, pose))
        elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID, kinds.mjGEOM_CAPSULE):
            enclosed.append(name)
            long = kind == kinds.mjGEOM_CAPSULE
            radii = size if kind == kinds.mjGEOM_ELLIPSOID else np.full(3, size[0])
            shapes.append(ball_around(name, radii, pose, float(size[1]) if long else 0.0))
        else:
            word = kind.name.removeprefix("mjGEOM_").lower()
            raise WorkcellError(
                f"scene {path}: geom '{name}' is of type {word}, which no obstacle can be; make it a mesh"
            )
    say_left_out(path, planes, "left out, since it is an endless plane")
    say_left_out(path, enclosed, ENCLOSED)
    say_left_out(
        path, [names[i] for i in np.flatnonzero(still & ~collides)], "left out, since nothing collides with it"
    )
    moving = np.unique(model.geom_bodyid[~still & collides])
    say_left_out(path, [model.body(i).name for i in moving], "left out, since it is a body that can move")
    if model.nflex:
        say_left_out(path, [model.flex(i).name for i in range(model.nflex)], "left out, since it is not rigid")
    return shapes
