"""One self-contained HTML page that shows a plan: a slider steps through picks and places, ghosts mark all poses."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import plotly.graph_objects as go
import trimesh

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.files import atomic_path
from regrasp_opt.shapes import Box, Cylinder, Shape

if TYPE_CHECKING:
    from regrasp_opt.planning import RegraspPlan

Surface = tuple[FloatArray, IntArray]
COLOURS = {
    "arm": "#c9d1d9",
    "gripper": "#57606a",
    "object": "#e69f00",
    "table": "#eaeef2",
    "obstacle": "#8b949e",
    "start": "#0072b2",
    "goal": "#009e73",
    "intermediate": "#cc79a7",
}


def write_plan_page(plan: RegraspPlan, path: str | os.PathLike[str]) -> None:
    """Write the page to `path`; it needs no network."""
    with atomic_path(path) as temporary:
        temporary.write_text(plan_figure(plan).to_html(include_plotlyjs=True, auto_play=False), encoding="utf-8")


def plan_figure(plan: RegraspPlan) -> go.Figure:
    """Return the plan as a plotly figure: fixed surroundings, then one frame for each pick and each place."""
    steps = _steps(plan)
    moving = [_moving_traces(plan, *step[1:]) for step in steps] or [[_object_trace(plan, plan.poses[0])]]
    figure = go.Figure(data=[*moving[0], *_fixed_traces(plan)])
    figure.frames = [
        go.Frame(data=traces, name=step[0], traces=list(range(len(traces))))
        for step, traces in zip(steps, moving, strict=False)
    ]
    slider_steps = [
        {
            "label": step[0],
            "method": "animate",
            "args": [[step[0]], {"mode": "immediate", "frame": {"duration": 0, "redraw": True}}],
        }
        for step in steps
    ]
    problem = plan.problem
    figure.update_layout(
        title=f"{problem.object.name} in {problem.workcell.name}: {plan.num_regrasps} regrasp(s)",
        scene={
            "aspectmode": "data",
            "xaxis_title": "x [m]",
            "yaxis_title": "y [m]",
            "zaxis_title": "z [m]",
            "camera": {"eye": {"x": 1.3, "y": 1.7, "z": 1.0}},
        },
        legend={"itemsizing": "constant"},
        margin={"l": 30, "r": 10, "t": 50, "b": 40},
        sliders=[{"active": 0, "steps": slider_steps, "pad": {"t": 10}}] if slider_steps else [],
    )
    return figure


def _steps(plan: RegraspPlan) -> list[tuple[str, FloatArray, FloatArray, int]]:
    """Return (label, object pose, configuration, grasp id) for each pick and place, with the clearest grasp."""
    steps = []
    for i, transition in enumerate(plan.transitions):
        best = int(transition.clearance.argmax())
        grasp_id = int(transition.grasp_ids[best])
        steps.append((f"pick {i}", plan.poses[i], transition.q_pick[best], grasp_id))
        steps.append((f"place {i}", plan.poses[i + 1], transition.q_place[best], grasp_id))
    return steps


def _fixed_traces(plan: RegraspPlan) -> list[Any]:
    cell = plan.problem.workcell
    traces = [_trace(_surface(cell.table.shape), "table", COLOURS["table"], 1.0)]
    traces += [_trace(_surface(s), s.name, COLOURS["obstacle"], 1.0) for s in cell.obstacles]
    names = ["start", *[f"pose {i}" for i in range(1, plan.num_regrasps + 1)], "goal"]
    for name, T in zip(names, plan.poses, strict=True):
        colour = COLOURS.get(name, COLOURS["intermediate"])
        traces.append(_trace(_placed(_object_surface(plan), T), name, colour, 0.35))
    return traces


def _moving_traces(plan: RegraspPlan, T: FloatArray, q: FloatArray, grasp_id: int) -> list[Any]:
    problem = plan.problem
    cell, effector = problem.workcell, problem.workcell.end_effector
    links = cell.robot.link_transforms(q)
    arm = []
    for item in cell.robot.collision.geometryObjects:
        T_joint = np.eye(4) if item.parentJoint == 0 else links[item.parentJoint - 1]
        arm.append(_placed(_coal_surface(item.geometry), cell.T_world_base @ T_joint @ item.placement.homogeneous))
    T_world_flange = cell.T_world_base @ cell.robot.forward(q)
    shapes = (*effector.body, *effector.finger_boxes(float(problem.grasps.width[grasp_id])))
    gripper = [_placed(_surface(s), T_world_flange) for s in shapes]
    return [
        _trace(_merged(arm), "arm", COLOURS["arm"], 1.0),
        _trace(_merged(gripper), "gripper", COLOURS["gripper"], 1.0),
        _object_trace(plan, T),
    ]


def _object_trace(plan: RegraspPlan, T: FloatArray) -> Any:
    return _trace(_placed(_object_surface(plan), T), "object", COLOURS["object"], 1.0)


def _object_surface(plan: RegraspPlan) -> Surface:
    return plan.problem.object.vertices, plan.problem.object.faces


def _trace(surface: Surface, name: str, colour: str, opacity: float) -> Any:
    vertices, faces = surface
    return go.Mesh3d(
        **dict(zip("xyz", np.round(vertices, 4).T, strict=True)),
        **dict(zip("ijk", faces.T, strict=True)),
        name=name,
        color=colour,
        opacity=opacity,
        flatshading=True,
        showlegend=True,
        hoverinfo="name",
    )


def _placed(surface: Surface, T: FloatArray) -> Surface:
    return surface[0] @ T[:3, :3].T + T[:3, 3], surface[1]


def _merged(surfaces: list[Surface]) -> Surface:
    offsets = np.cumsum([0, *(len(v) for v, _ in surfaces[:-1])])
    faces = [f + offset for (_, f), offset in zip(surfaces, offsets, strict=True)]
    return np.concatenate([v for v, _ in surfaces]), np.concatenate(faces)


def _surface(shape: Shape) -> Surface:
    if isinstance(shape, Box):
        mesh = trimesh.creation.box(shape.size)
    elif isinstance(shape, Cylinder):
        mesh = trimesh.creation.cylinder(shape.radius, shape.length, sections=24)
    else:
        return _placed((shape.vertices, shape.faces), shape.pose)
    return _placed((np.array(mesh.vertices), np.array(mesh.faces)), shape.pose)


def _coal_surface(geometry: Any) -> Surface:
    """Return the surface of a robot's collision body."""
    if isinstance(geometry, coal.Box):
        mesh = trimesh.creation.box(2 * np.array(geometry.halfSide))
    elif isinstance(geometry, coal.Sphere):
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=geometry.radius)
    elif isinstance(geometry, coal.Cylinder):
        mesh = trimesh.creation.cylinder(geometry.radius, 2 * geometry.halfLength, sections=24)
    elif isinstance(geometry, coal.Capsule):
        mesh = trimesh.creation.capsule(2 * geometry.halfLength, geometry.radius, count=[12, 12])
        mesh.apply_translation([0, 0, -geometry.halfLength - (mesh.bounds[0][2] + geometry.radius)])
    else:
        triangles = [geometry.tri_indices(i) for i in range(geometry.num_tris)]
        return np.array(geometry.vertices()), np.array([[t[0], t[1], t[2]] for t in triangles])
    return np.array(mesh.vertices), np.array(mesh.faces)
