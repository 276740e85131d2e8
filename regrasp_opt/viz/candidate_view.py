"""The candidates of a refiner in the live viewer: a slider over its iterations, the object at each candidate pose."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from regrasp_opt.conventions import IntArray
from regrasp_opt.viz.candidates import cost_range, trail
from regrasp_opt.viz.scene import PlanScene, pose7, scaled_colours
from regrasp_opt.viz.surfaces import Patch

ACCEPTED = (214, 26, 26)
TAIL = 5
"""Steps of which the trail is shown."""


class CandidateView:
    """Adds the candidates of `scene` to a viser `server`, with a check box and a slider of their own.

    Attributes
    ----------
    handles : list of lists
        viser's handles of the object at the poses of each candidate.
    trail : handle or None
        Of the ribbons along which the candidates have just moved.
    """

    def __init__(self, server: Any, scene: PlanScene) -> None:
        assert scene.candidates is not None
        self._server, self._trace = server, scene.candidates
        frames, count, length = self._trace.xi.shape[:3]
        ends = cost_range(self._trace)
        self._poses = pose7(self._trace.poses)
        self._colours = scaled_colours(self._trace.cost, ends)
        self._ribbons, cost = trail(self._trace, scene.table_height)
        self._ribbon_colours = scaled_colours(cost, ends)
        self._each = 2 * count * length
        vertices, faces = scene.object_surface.vertices.astype(np.float32), scene.object_surface.faces.astype(np.uint32)
        self.handles = [
            [server.scene.add_mesh_simple(f"/candidates/{b}/{i}", vertices, faces, opacity=0.5) for i in range(length)]
            for b in range(count)
        ]
        self.trail: Any = None
        self._shown = server.gui.add_checkbox("candidates by iteration", True)
        self._slider = server.gui.add_slider("iteration", min=0, max=frames - 1, step=1, initial_value=0)
        self._text = server.gui.add_markdown("")
        self._shown.on_update(lambda _: self.show(self.frame))
        self._slider.on_update(lambda _: self.show(int(self._slider.value)))
        self.show(0)

    @property
    def frame(self) -> int:
        """The frame of the trace that is shown."""
        return int(self._slider.value)

    @property
    def text(self) -> str:
        """What is said about the frame."""
        return str(self._text.content)

    def show(self, frame: int) -> None:
        """Show frame number `frame`: 0 has the start points, the last one what the refiner returned."""
        if self.frame != frame:
            self._slider.value = frame
        visible = bool(self._shown.value)
        with self._server.atomic():
            for b, row in enumerate(self.handles):
                accepted = b == self._trace.accepted
                colour = ACCEPTED if accepted else tuple(self._colours[frame, b].tolist())
                for i, handle in enumerate(row):
                    pose = self._poses[frame, b, i]
                    handle.position, handle.wxyz, handle.visible = pose[:3], pose[[6, 3, 4, 5]], visible
                    handle.color = colour
            self._draw_trail(frame, visible)
            self._text.content = self._trace.label(frame)

    def _draw_trail(self, frame: int, visible: bool) -> None:
        if self.trail is not None:
            self.trail.remove()
            self.trail = None
        faces = self._ribbons.faces[self._each * max(0, frame - TAIL) : self._each * frame]
        if visible and len(faces):
            part = Patch(self._ribbons.vertices, faces)
            self.trail = add_coloured(self._server, "/candidates/trail", part, self._ribbon_colours)


def add_coloured(server: Any, name: str, surface: Patch, colours: IntArray, *, visible: bool = True) -> Any:
    """Add a surface with a colour (V, 3) for each vertex to a viser `server` and return its handle."""
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, vertex_colors=colours, process=False)
    return server.scene.add_mesh_trimesh(name, mesh, cast_shadow=False, visible=visible)
