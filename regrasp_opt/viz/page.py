"""One self-contained HTML page that shows a plan or a motion; it loads nothing and draws with plain WebGL."""

from __future__ import annotations

import base64
import html
import json
import math
import os
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regrasp_opt.conventions import FloatArray
from regrasp_opt.files import atomic_path
from regrasp_opt.motion import MotionPlan
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.scene import Workcell
from regrasp_opt.viz.candidates import CandidateTrace, cost_range, trail
from regrasp_opt.viz.fields import CostField
from regrasp_opt.viz.legend import legend
from regrasp_opt.viz.looks import COLOURS
from regrasp_opt.viz.scene import SCALE, PlanScene, SharedGrasps, plan_scene, pose7, problem_scene, scaled_colours
from regrasp_opt.viz.surfaces import Patch
from regrasp_opt.viz.track import Track, track_of


def write_plan_page(
    plan: RegraspPlan,
    path: str | os.PathLike[str],
    track: Track | None = None,
    candidates: CandidateTrace | None = None,
) -> None:
    """Write a page that shows `plan` to `path`; it needs no network.

    Parameters
    ----------
    plan : RegraspPlan
    path : path
    track : Track, optional
        A motion that carries the plan out; its moments are the steps of the slider.
    candidates : CandidateTrace, optional
        Candidates of a refiner, to be shown by iteration.
    """
    _write(plan_scene(plan, track, candidates), path)


def write_problem_page(model: ObjectModel, workcell: Workcell, path: str | os.PathLike[str]) -> None:
    """Write a page that shows the arm of `workcell` at home and the placements of `model`; it needs no network."""
    _write(problem_scene(model, workcell), path)


def _write(scene: PlanScene, path: str | os.PathLike[str]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(page_text(scene), encoding="utf-8")


def page_of(shown: RegraspPlan | MotionPlan) -> str:
    """Return the page that shows a plan or a motion; that of its plan if the motion was not found."""
    if isinstance(shown, RegraspPlan):
        return page_text(plan_scene(shown))
    return page_text(plan_scene(shown.plan, track_of(shown.plan, shown.segments) if shown.solved else None))


def page_text(scene: PlanScene) -> str:
    """Return the page that draws `scene`."""
    folder = files("regrasp_opt") / "data" / "page"
    content = json.dumps(_content(scene), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    fill = {
        "{{title}}": html.escape(scene.title),
        "{{scene}}": content,
        "{{script}}": (folder / "page.js").read_text(encoding="utf-8"),
    }
    page = (folder / "page.html").read_text(encoding="utf-8")
    for name, text in fill.items():
        before, after = page.split(name, 1)
        page = before + text + after
    return page


def _content(scene: PlanScene) -> dict[str, Any]:
    meshes = [*(part.surface for part in scene.parts), scene.object_surface, scene.mark]
    return {
        "title": scene.title,
        "subtitle": scene.subtitle,
        "meshes": [_mesh(surface) for surface in meshes],
        "parts": [
            {"name": part.name, "mesh": k, "colour": part.colour, "body": part.body}
            for k, part in enumerate(scene.parts)
        ],
        "legend": legend(scene),
        "chosen": COLOURS["chosen"],
        "object": len(meshes) - 2,
        "mark": len(meshes) - 1,
        "ghosts": [{"name": name, "colour": colour, "pose": _rounded(pose)} for name, colour, pose in scene.ghosts],
        "bodies": scene.states.shape[1],
        "states": _packed(scene.states, np.float32),
        "steps": [step._asdict() for step in scene.steps],
        "stops": [stop._asdict() for stop in scene.stops],
        "seconds": scene.seconds,
        "grasps": [_grasps(shared) for shared in scene.grasps],
        "marks": _rounded(scene.marks),
        "fields": [_field(field) for field in scene.fields],
        "causes": [{"legend": each.legend, "of_grasp": each.of_grasp.tolist()} for each in scene.causes],
        "candidates": _candidates(scene.candidates),
        "scale": SCALE,
        "table_height": scene.table_height,
        "eye": _rounded(scene.eye),
        "target": _rounded(scene.target),
    }


def _grasps(shared: SharedGrasps) -> dict[str, Any]:
    energies = [None if math.isnan(e) else round(e, 4) for e in shared.energies.tolist()]
    if np.isnan(shared.energies).any():
        ends = [1e3 * float(shared.clearance.max()), 1e3 * float(np.percentile(shared.clearance, 10))]
    else:
        ends = [float(shared.energies.min()), float(np.percentile(shared.energies, 90))]
    return {
        "ids": shared.ids.tolist(),
        "energies": energies,
        "clearance": _rounded(shared.clearance),
        "colours": shared.colours.tolist(),
        "ends": ends,
        "best": shared.best,
        "first_state": shared.first_state,
    }


def _field(field: CostField) -> dict[str, Any]:
    surface, colours = field_surface(field)
    mesh = _mesh(surface)
    mesh["colours"] = _packed(colours, np.uint8)
    low, high = float(field.cost.min()), float(np.percentile(field.cost, 90))
    return {"number": field.number, "mesh": mesh, "low": low, "high": high}


def _candidates(trace: CandidateTrace | None) -> dict[str, Any] | None:
    if trace is None:
        return None
    frames, count, length = trace.xi.shape[:3]
    ends = cost_range(trace)
    surface, cost = trail(trace)
    mesh = _mesh(surface)
    mesh["colours"] = _packed(scaled_colours(cost, ends), np.uint8)
    return {
        "labels": [trace.label(k) for k in range(frames)],
        "count": count,
        "length": length,
        "poses": _packed(pose7(trace.poses), np.float32),
        "colours": _packed(scaled_colours(trace.cost, ends), np.uint8),
        "accepted": -1 if trace.accepted is None else trace.accepted,
        "trail": mesh,
        "ends": _rounded(np.array(ends)),
    }


def field_surface(field: CostField) -> tuple[Patch, NDArray[Any]]:
    """Return a field as a surface just above its support with the colours (V, 3) uint8 of its vertices."""
    x, y = np.meshgrid(field.x, field.y)
    T = field.T_world_support
    vertices = np.stack([x, y, np.full_like(x, 0.0008)], axis=-1).reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Patch(vertices, faces), scaled_colours(field.cost).reshape(-1, 3)


def _mesh(surface: Patch) -> dict[str, str]:
    return {"vertices": _packed(surface.vertices, np.float32), "faces": _packed(surface.faces, np.uint32)}


def _packed(array: NDArray[Any], kind: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def _rounded(array: FloatArray) -> Any:
    return np.round(np.asarray(array, dtype=np.float64), 6).tolist()
