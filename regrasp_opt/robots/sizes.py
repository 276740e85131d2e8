"""Whether the bodies of a robot have believable sizes, and which of its meshes have no inside."""

from __future__ import annotations

import logging

import numpy as np

from regrasp_opt.errors import WorkcellError
from regrasp_opt.geometry.mesh_files import LARGEST_MESH, unlikely_size
from regrasp_opt.geometry.shapes import mesh_faces
from regrasp_opt.geometry.solids import Solid
from regrasp_opt.robots.robot import Robot
from regrasp_opt.robots.urdf import parse_xml

logger = logging.getLogger(__name__)

MOST_REACHES = 3.0
"""A body that moves is believed to be at most so many times as long as the arm reaches."""

SHORT_REACH = 0.3
"""Arms that reach less far than this are taken to reach so far [m]: the tip may be at the last joint."""


def check_sizes(robot: Robot) -> None:
    """Refuse bodies out of proportion; log one line that names the links with meshes that are not closed.

    Raises
    ------
    WorkcellError
        If a body that moves is far longer than the arm reaches, a mesh that stands still is longer than that of any
        obstacle may be, or a mesh is smaller than a millimetre. The message has the scale to write.
    """
    links = {link.get("name"): link for link in parse_xml(robot.urdf).iterfind("link")}
    largest = MOST_REACHES * max(robot.max_reach, SHORT_REACH)
    open_links = []
    for index, item in enumerate(robot.collision.geometryObjects):
        solid, link = Solid(item.geometry), robot.link_of(index)
        number = int(item.name.rpartition("_")[2])
        where = f"{robot.urdf_path}: link '{link}', <collision> number {number + 1}"
        if solid.is_mesh:
            points = np.array(item.geometry.vertices())[np.unique(mesh_faces(item.geometry))]
            wrong = unlikely_size(points, largest if item.parentJoint else LARGEST_MESH)
            if wrong is not None:
                mesh = links[link].findall("collision")[number].find("geometry/mesh")
                given = "1 1 1" if mesh is None else mesh.get("scale", "1 1 1")
                scale = " ".join(f"{float(word) * wrong[1]:g}" for word in given.split())
                raise WorkcellError(f'{where}: its mesh {wrong[0]}; write scale="{scale}" in its <mesh>')
            if solid.shells.open_parts and link not in open_links:
                open_links.append(link)
        elif item.parentJoint and (longest := float(np.ptp(solid.box, axis=0).max())) > largest:
            raise WorkcellError(f"{where} is {longest:.4g} m long, far longer than the arm; give its sizes in metres")
    if open_links:
        text = "%s: meshes of %s are not closed: only their surfaces are tested, not what is inside; close solid ones"
        logger.warning(text, robot.urdf_path, ", ".join(open_links))
