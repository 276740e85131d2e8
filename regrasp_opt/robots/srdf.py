"""What an SRDF file says of a robot: links that are never tested against each other, and named configurations."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from regrasp_opt.errors import WorkcellError
from regrasp_opt.robots import urdf


class Semantics(NamedTuple):
    """Pairs of links, each a frozenset; for each named state the values of its joints [rad, m].

    `disputed` has the joints that several groups' states of one name put in different places, by the name of the state.
    """

    ignored: frozenset[frozenset[str]]
    states: dict[str, dict[str, float]]
    disputed: dict[str, str]


def read_srdf(path: Path, links: Collection[str], joints: Collection[str]) -> Semantics:
    """Return what the SRDF file at `path` says of an arm of `joints` in a robot of `links`.

    What it says of others is passed over. States of one name for several groups are one state, unless one of them says
    where the whole arm is: then that one counts.

    Raises
    ------
    WorkcellError
        If the file cannot be read, is not an SRDF, or a state has a value for one of `joints` that is not a number.
    """
    try:
        root = urdf.parse_xml(path.read_bytes())
    except OSError as error:
        raise WorkcellError(f"SRDF file {path} cannot be read; give the path of an SRDF file") from error
    except ValueError as error:
        raise WorkcellError(f"SRDF file {path} is not valid XML: {error}") from error
    if root.tag != "robot" or root.find("link") is not None:
        raise WorkcellError(f"{path} is not an SRDF file; give the one that MoveIt made for the robot")
    alone = {element.get("link") for element in root.iterfind("disable_default_collisions")}
    pairs = {frozenset(pair) for pair in combinations(links, 2) if alone.intersection(pair)}
    pairs -= _pairs(root, "enable_collisions")
    pairs |= {pair for pair in _pairs(root, "disable_collisions") if len(pair) == 2 and pair.issubset(links)}
    found: dict[str, list[dict[str, float]]] = {}
    for state in root.iterfind("group_state"):
        name, values = state.get("name", ""), dict[str, float]()
        for joint in state.iterfind("joint"):
            if joint.get("name") in joints:
                value = urdf.numbers(joint.get("value", ""), 1)
                if not value:
                    raise WorkcellError(
                        f"{path}: state '{name}' has value=\"{joint.get('value')}\" for joint '{joint.get('name')}'; "
                        "give one number"
                    )
                values[joint.get("name", "")] = value[0]
        found.setdefault(name, []).append(values)
    states, disputed = dict[str, dict[str, float]](), dict[str, str]()
    for name, parts in found.items():
        states[name] = {}
        for values in [part for part in parts if len(part) == len(joints)] or parts:
            for mover, number in values.items():
                if states[name].setdefault(mover, number) != number:
                    disputed[name] = mover
    return Semantics(frozenset(pairs), states, disputed)


def _pairs(root: ET.Element, tag: str) -> set[frozenset[str]]:
    return {frozenset((element.get("link1", ""), element.get("link2", ""))) for element in root.iterfind(tag)}
