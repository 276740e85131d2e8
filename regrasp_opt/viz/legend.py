"""The legend of a page: a name for every colour that something is drawn in."""

from __future__ import annotations

from typing import Any

from regrasp_opt.viz.looks import COLOURS
from regrasp_opt.viz.scene import PlanScene

SHOWN = 3
"""Names in one line at most."""
KINDS = (
    ("object", ("object",)),
    ("arm", ("arm", "joint")),
    ("gripper", ("gripper", "finger")),
    ("support", ("table",)),
    ("obstacle", ("obstacle",)),
)
"""What the parts of a scene are, and their colours by name; of the last two the legend names each."""


def legend(scene: PlanScene) -> list[dict[str, Any]]:
    """Return name, colours and opacity of each kind of thing; grasps have a scale, or a legend of causes, besides."""
    ghosts: dict[str, list[str]] = {}
    for name, colour, _ in scene.ghosts:
        ghosts.setdefault(colour, []).append(name)
    lines = [_line(_listed(names), (colour,), 0.5) for colour, names in ghosts.items()]
    for kind, keys in KINDS:
        colours = tuple(COLOURS[key] for key in keys)
        names = list(dict.fromkeys(part.name for part in scene.parts if part.colour in colours))
        if names:
            lines.append(_line(f"{kind}: {_listed(names)}" if kind in ("support", "obstacle") else kind, colours))
    if scene.grasps:
        lines.append(_line("grasp in use", (COLOURS["chosen"],)))
    if scene.candidates is not None and scene.candidates.accepted is not None:
        lines.append(_line("candidate that became the plan", (COLOURS["chosen"],)))
    return lines


def _line(name: str, colours: tuple[str, ...], opacity: float = 1.0) -> dict[str, Any]:
    return {"name": name, "colours": colours, "opacity": opacity}


def _listed(names: list[str]) -> str:
    return ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")
