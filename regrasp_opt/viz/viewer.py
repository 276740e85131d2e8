"""A live view of a plan or a motion in the browser, served on this machine by viser (extra ``viz``)."""

from __future__ import annotations

import contextlib
import io
import time
from typing import Any

import numpy as np
from plotly.colors import hex_to_rgb

from regrasp_opt.errors import OptionError
from regrasp_opt.viz.candidate_view import CandidateView, add_coloured
from regrasp_opt.viz.page import field_surface
from regrasp_opt.viz.scene import PlanScene
from regrasp_opt.viz.surfaces import Patch

HIDDEN = "hidden"
FIELD_OF_VIEW = 0.7
"""Of the camera, from top to bottom [rad]."""


class PlanViewer:
    """Serves a `PlanScene`: steps, shared grasps to click, the cost over the table, candidates of a refiner.

    Parameters
    ----------
    scene : PlanScene
    port : int
        Where to listen; the next free port is taken if it is in use.
    host : str
        Address to listen on; by default only this machine can connect.
    shadows : bool
        Whether the lights cast shadows, which is slow without a graphics card.

    Attributes
    ----------
    url : str
        Where to point a browser.
    candidates : CandidateView or None

    Raises
    ------
    OptionError
        If viser is not installed.
    """

    def __init__(self, scene: PlanScene, port: int = 8080, host: str = "127.0.0.1", shadows: bool = True) -> None:
        self._scene = scene
        viser = _viser()
        with contextlib.redirect_stdout(io.StringIO()):  # it announces itself there
            self._server = viser.ViserServer(host=host, port=port, verbose=False)
        self.url = f"http://{host}:{self._server.get_port()}"
        self._chosen = [shared.best for shared in scene.grasps]
        self._step, self._marks_of = 0, -1
        self._marks: list[Any] = []
        self._server.scene.configure_default_lights(cast_shadow=shadows)
        self._server.initial_camera.position = tuple(scene.eye)
        self._server.initial_camera.look_at = tuple(scene.target)
        self._server.initial_camera.fov = FIELD_OF_VIEW
        self._bodies = [self._frame(f"/body {i}") for i in range(scene.states.shape[1])]
        for number, part in enumerate(scene.parts):
            self._mesh(f"{self._parent(part.body)}/{part.name} {number}", part.surface, hex_to_rgb(part.colour))
        self._ghosts = [
            self._placed_mesh(f"/poses/{name}", scene.object_surface, hex_to_rgb(colour), pose, opacity=0.45)
            for name, colour, pose in scene.ghosts
        ]
        self._fields = [self._add_field(number) for number in range(len(scene.fields))]
        self._add_controls()
        self.candidates = None if scene.candidates is None else CandidateView(self._server, scene)
        self.show(0)

    @property
    def step(self) -> int:
        """The step that is shown."""
        return self._step

    def show(self, step: int) -> None:
        """Show step number `step`."""
        self._step = step
        if self._slider.value != step:
            self._slider.value = step
        here = self._scene.steps[step]
        poses = self._scene.states[self._state(step)]
        with self._server.atomic():
            for frame, pose in zip(self._bodies, poses, strict=True):
                frame.position, frame.wxyz = pose[:3], pose[[6, 3, 4, 5]]
            for ghost, (_, _, pose) in zip(self._ghosts, self._scene.ghosts, strict=True):
                ghost.visible = self._show_ghosts.value and not _same(pose, poses[-1])
            self._mark_grasps(here.transition)
            self._text.content = f"**{here.label}**\n\n{self._described(here.transition)}"

    def choose(self, transition: int, number: int) -> None:
        """Carry out `transition` with shared grasp `number` of it (not its id)."""
        self._chosen[transition], self._marks_of = number, -1
        self.show(self._step)

    def wait(self) -> None:
        """Serve until interrupted; the play button works only meanwhile."""
        scene = self._scene
        pause = 1.2 if scene.seconds is None else scene.seconds / max(len(scene.steps) - 1, 1)
        while True:
            time.sleep(pause)
            if self._play.value:
                self._slider.value = (self._step + 1) % len(scene.steps)

    def stop(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _state(self, step: int) -> int:
        _, transition, state = self._scene.steps[step]
        if self._scene.seconds is not None or transition < 0:
            return state
        first = self._scene.grasps[transition].first_state
        return first + 2 * self._chosen[transition] + (state - first) % 2

    def _described(self, transition: int) -> str:
        if transition < 0:
            return self._scene.subtitle
        shared, k = self._scene.grasps[transition], self._chosen[transition]
        energy = "" if np.isnan(shared.energies[k]) else f"energy {shared.energies[k]:.3f}, "
        clearance = f"clearance {1e3 * shared.clearance[k]:.1f} mm"
        return f"grasp {shared.ids[k]}, one of {len(shared.ids)} shared: {energy}{clearance}"

    def _add_controls(self) -> None:
        gui, scene = self._server.gui, self._scene
        gui.configure_theme(dark_mode=False, show_logo=False, show_share_button=False)
        gui.set_panel_label("regrasp-opt")
        gui.add_markdown(f"### {scene.title}\n{scene.subtitle}")
        self._slider = gui.add_slider("step", min=0, max=max(len(scene.steps) - 1, 1), step=1, initial_value=0)
        self._slider.disabled = len(scene.steps) == 1
        self._play = gui.add_checkbox("play", False)
        self._text = gui.add_markdown("")
        self._show_ghosts = gui.add_checkbox("poses of the plan", True)
        self._show_marks = gui.add_checkbox("shared grasps of the move", True)
        names = [HIDDEN, *(f"of pose {field.number}" for field in scene.fields)]
        field = gui.add_dropdown("cost over the table", names, visible=len(names) > 1)
        self._slider.on_update(lambda _: self.show(min(int(self._slider.value), len(scene.steps) - 1)))
        for box in (self._show_ghosts, self._show_marks):
            box.on_update(lambda _: self._redraw())
        field.on_update(lambda _: self._show_field(names.index(field.value) - 1))

    def _redraw(self) -> None:
        self._marks_of = -1
        self.show(self._step)

    def _show_field(self, number: int) -> None:
        for k, handle in enumerate(self._fields):
            handle.visible = k == number

    def _mark_grasps(self, transition: int) -> None:
        """Hang marks of the transition's shared grasps on the object, unless they hang there already."""
        if transition == self._marks_of:
            return
        for handle in self._marks:
            handle.remove()
        self._marks, self._marks_of = [], transition
        if transition < 0 or not self._show_marks.value:
            return
        shared, parent = self._scene.grasps[transition], self._parent(self._scene.object_body)
        for k, grasp_id in enumerate(shared.ids.tolist()):
            colour = (214, 26, 26) if k == self._chosen[transition] else tuple(shared.colours[k].tolist())
            name = f"{parent}/grasp {grasp_id}"
            handle = self._placed_mesh(name, self._scene.mark, colour, self._scene.marks[grasp_id])
            if self._scene.seconds is None:  # a motion has its grasps
                handle.on_click(lambda _, k=k: self.choose(transition, k))
            self._marks.append(handle)

    def _add_field(self, number: int) -> Any:
        field = self._scene.fields[number]
        surface, colours = field_surface(field, self._scene.table_height)
        return add_coloured(self._server, f"/cost/{field.number}", surface, colours, visible=False)

    def _parent(self, body: int) -> str:
        return f"/body {body}" if body >= 0 else "/fixed"

    def _frame(self, name: str) -> Any:
        return self._server.scene.add_frame(name, show_axes=False)

    def _mesh(self, name: str, surface: Patch, colour: Any, **options: Any) -> Any:
        return self._server.scene.add_mesh_simple(
            name, surface.vertices.astype(np.float32), surface.faces.astype(np.uint32), color=colour, **options
        )

    def _placed_mesh(self, name: str, surface: Patch, colour: Any, pose: Any, **options: Any) -> Any:
        return self._mesh(name, surface, colour, position=pose[:3], wxyz=pose[[6, 3, 4, 5]], **options)


def _same(a: Any, b: Any) -> bool:
    return bool(np.linalg.norm(a[:3] - b[:3]) < 2e-3 and abs(float(a[3:] @ b[3:])) > 0.9999)


def _viser() -> Any:
    try:
        import viser
    except ImportError as error:
        raise OptionError(
            "the viewer needs viser; install 'regrasp-opt[viz]', or write a page with 'regrasp-opt show --html FILE'"
        ) from error
    return viser
