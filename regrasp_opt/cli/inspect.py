"""`regrasp-opt inspect`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from regrasp_opt.cli.output import make_console, plain_table, working
from regrasp_opt.errors import GraspError, HomeCollisionError, RegraspError
from regrasp_opt.objects import ObjectModel, load_object
from regrasp_opt.objects.changes import Changes
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.explanation import Explanation
from regrasp_opt.planning.inspection import (
    counted_bodies,
    describe_grasps,
    describe_object,
    describe_workcell,
)
from regrasp_opt.planning.pose_text import parse_pose
from regrasp_opt.planning.rests import Rests
from regrasp_opt.scene import Workcell, load_workcell


def run_inspect(
    cell_name: str | None,
    object_name: str | None,
    mesh: dict[str, Any],
    cell: dict[str, Any],
    pose: str | None,
    *,
    html: Path | None,
    as_json: bool,
) -> int:
    """Print what was understood of the workcell, the object and the grasps of both, or of one pose; return 0.

    `mesh` and `cell` are options of `load_object` and `load_workcell`. A workcell that is refused because the arm
    collides at home, and an object that no grasp fits, are described before the error is raised.
    """
    workcell, refused = None, list[RegraspError]()
    if cell_name is not None:
        try:
            workcell = load_workcell(cell_name, **cell)
        except HomeCollisionError as error:
            workcell, refused = error.workcell, [error]
    model = None if object_name is None else load_object(object_name, **mesh)
    problem = None
    try:
        problem = _problem(model, workcell)
    except GraspError as error:
        refused.append(error)
    data = {
        "workcell": None if workcell is None else describe_workcell(workcell),
        "object": None if model is None else describe_object(model),
        "grasps": None if problem is None else describe_grasps(problem),
    }
    explanation = None
    if pose is not None and problem is not None:
        T = parse_pose(pose, "pose", problem)
        with working("looking for the causes and what would help"):
            explanation = problem.explain(T)
        data = {"explanation": explanation.data()}
    if html is not None and model is not None and workcell is not None:
        from regrasp_opt.viz import write_problem_page

        write_problem_page(model, workcell, html)
    if as_json:
        print(json.dumps(data))
    else:
        _show(data, explanation, html)
    if refused:
        raise refused[0]
    return 0


def _show(data: dict[str, Any], explanation: Explanation | None, html: Path | None) -> None:
    console = make_console()
    if explanation is not None:
        console.print(str(explanation), markup=False, soft_wrap=True)
    if data.get("workcell") is not None:
        _show_workcell(console, data["workcell"])
    if data.get("object") is not None:
        _show_object(console, data["object"])
        _show_placements(console, data["object"], data["grasps"])
    if html is not None:
        console.print(f"written: {html}", markup=False, soft_wrap=True)


def _problem(model: ObjectModel | None, workcell: Workcell | None) -> RegraspProblem | None:
    if model is None or workcell is None or not len(Rests.of(model, workcell)):
        return None
    with working("looking for grasps"):
        return RegraspProblem.load(model, workcell)


def _show_workcell(console: Console, cell: dict[str, Any]) -> None:
    robot, effector = cell["robot"], cell["end_effector"]
    _heading(console, f"workcell {cell['name']}", cell["source"])
    _show_robot(console, robot)
    holds = (
        f"cup of radius {_mm(effector['cup_radius'])}"
        if effector["kind"] == "suction"
        else f"opens to {_mm(effector['max_opening'])}, approaches {_mm(effector['pre_opening'])} wider per side, pads "
        f"{_mm(*np.ptp([effector['pad']['x'], effector['pad']['z']], axis=1))}"
    )
    _facts(
        console,
        ("end-effector", f"{effector['name']}, {effector['kind']}: {holds}"),
        ("its TCP", f"{_mm(effector['tcp_offset'])} from the flange"),
        ("its bodies", counted_bodies(effector["bodies"])),
        *(("support", _support(support)) for support in cell["supports"]),
        *(("obstacle", f"{o['name']}: {counted_bodies([o])} at {_point(o['position'])}") for o in cell["obstacles"]),
        ("clearance", ", ".join(f"{name.replace('_', '-')} {_mm(d)}" for name, d in cell["clearance"].items())),
    )


def _support(support: dict[str, Any]) -> str:
    if "poses" in support:
        return f"{support['name']}: a fixture at z = {support['height']:g}, which holds {', '.join(support['poses'])}"
    (x_low, x_high), (y_low, y_high) = (support["workspace"][axis] for axis in "xy")
    length, width = support["size"]
    tilt = f", tilted by {support['tilt']:.1f} degrees" if support["tilt"] else ""
    return (
        f"{support['name']}: top at z = {support['height']:g}, {length:g} x {width:g} m around "
        f"{_point(support['center'])}{tilt}; objects at x [{x_low:g}, {x_high:g}], y [{y_low:g}, {y_high:g}] m"
    )


def _show_robot(console: Console, robot: dict[str, Any]) -> None:
    ik, bare = robot["inverse_kinematics"], robot["links_without_body"]
    solved = f"solves {ik['solved']} of {ik['tried']} poses of this arm, residual at most {ik['residual']:.0e}"
    if len(robot["joints"]) <= 6:  # more joints have infinitely many solutions
        solved += f"; for {ik['found']} the solutions include the configuration that the pose came from"
    _facts(
        console,
        ("robot", f"{robot['name']}, {robot['file']}"),
        ("base at", f"{_point(robot['position'])} m"),
        ("tip", f"{robot['tip']['link']}: {robot['tip']['why']}; reach at most {robot['reach']:.2f} m"),
        ("inverse kinematics", f"{ik['solver']}; {solved}"),
        ("links without a body", ", ".join(bare) or "none that moves"),
    )
    joints = plain_table("joint", "moves", "lower", "upper", "speed", "home", right=4)
    for joint in robot["joints"]:
        numbers = [f"{joint[key]:.3f}" for key in ("lower", "upper", "speed", "home")]
        joints.add_row(escape(joint["name"]), "slides" if joint["slides"] else "turns", *numbers)
    console.print(joints)
    links = plain_table("link", "moved by", "bodies [mm]")
    for link in robot["bodies"]:
        links.add_row(escape(link["link"]), escape(link["moved_by"]), escape(counted_bodies(link["bodies"])))
    console.print(links if robot["bodies"] else "the robot has no body: no part of the arm is tested for collision")
    for why in dict.fromkeys(pair["why"] for pair in robot["never_tested"]):
        pairs = [" - ".join(pair["links"]) for pair in robot["never_tested"] if pair["why"] == why]
        _facts(console, (f"never tested, {why}", ", ".join(pairs)))


def _show_object(console: Console, model: dict[str, Any]) -> None:
    changes, given = model["changes"], model["mass_properties_given"]
    mass = model["mass"] or model["volume"] * 1e3
    assumed = "" if model["mass"] else " at the density of water"
    center = "as given" if "center_of_mass" in given else "at uniform density"
    inertia = "inertia as given" if "inertia" in given else "at uniform density"
    _heading(console, f"object {model['name']}", model["source"])
    _facts(
        console,
        ("size", f"{_mm(*model['size'])}, scale {model['scale']:g}, {model['faces']} faces"),
        ("volume", f"{1e6 * model['volume']:.1f} cm3, {mass:.3f} kg{assumed}"),
        ("centre of mass", f"{_mm(*model['center_of_mass'], by=', ')} in the frame of the mesh, {center}"),
        ("radii of gyration", f"{_mm(*model['radii_of_gyration'], by=', ')} about the principal axes, {inertia}"),
        ("changes", "none" if changes is None else Changes(**changes).sentence()),
    )


def _show_placements(console: Console, model: dict[str, Any], grasps: dict[str, Any] | None) -> None:
    headings = ["placement", "height [mm]", "centre of mass [mm]", "margin"]
    table = plain_table(*headings, *(["grasps that the table leaves"] if grasps else []), right=5)
    for number, placement in enumerate(model["placements"]):
        heights = (f"{1e3 * placement[key]:.1f}" for key in ("height", "center_height"))
        left = [f"{grasps['left_by_table'][number]} of {grasps['count']}"] if grasps else []
        table.add_row(str(number), *heights, f"{placement['margin']:.3f}", *left)
    console.print(table if model["placements"] else "no stable placement, so it cannot be planned")
    for why, text in (("rolls", "it rolls there"), ("margin", f"margin below {model['least_margin']:g}")):
        margins = [r["margin"] for r in model["rejected"] if r["why"] == why]
        if margins:
            _facts(console, (f"not stable, {text}", f"{len(margins)} facet(s), margin at most {max(margins):.3f}"))
    if grasps:
        low, high = grasps["widths"]
        _facts(console, ("grasps", f"{grasps['count']}, {grasps['source']}, jaw {_mm(low)} to {_mm(high)}"))


def _heading(console: Console, what: str, source: str) -> None:
    console.print(f"[bold]{escape(what)}[/] ({escape(source)})", soft_wrap=True)


def _facts(console: Console, *facts: tuple[str, str]) -> None:
    for name, text in facts:
        console.print(f"  {escape(name)}: {escape(text)}", soft_wrap=True)


def _mm(*lengths: float, by: str = " x ") -> str:
    return f"{by.join(f'{round(1e3 * length, 1) + 0.0:.1f}' for length in lengths)} mm"


def _point(point: Iterable[float]) -> str:
    return f"({', '.join(f'{x:g}' for x in point)})"
