"""Where the meshes of a URDF are: beside the file, at a ``file://`` address, or in a package."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

from regrasp_opt.errors import WorkcellError
from regrasp_opt.files import report_outside
from regrasp_opt.robots.urdf import parse_xml


def settle_meshes(root: ET.Element, path: Path, package_dirs: Iterable[str | os.PathLike[str]]) -> None:
    """Make the names of all mesh and texture files absolute, in place; those of visuals only where they are found.

    A package is a folder of its name, or one whose package.xml has that name. It is looked for among `package_dirs`,
    what is directly in them, the folders above the URDF file, what is named like it directly in those, and the packages
    beside its own. Collision meshes elsewhere than in the folder of the URDF file, in its own package and in
    `package_dirs` are reported in one warning.

    Raises
    ------
    WorkcellError
        If a collision mesh is not found.
    """
    given, above = [Path(folder) for folder in package_dirs], list(path.resolve().parents)
    solid = {mesh: None for mesh in root.iterfind("link/collision/geometry/mesh")}
    used = []
    for element in (*root.iter("mesh"), *root.iter("texture")):
        name = element.get("filename", "")
        candidates = _candidates(name, path, given, above)
        found = next((file for file in candidates if os.path.isfile(file)), None)
        if found is not None:
            element.set("filename", str(found.resolve()))
            used += [found] if element in solid else []
        elif element in solid:
            raise WorkcellError(f"{path}: mesh '{name}' is not found; {_advice(name, path, given, candidates)}")
    own = [folder for folder in above if (folder / "package.xml").is_file()][:1]
    report_outside(path, used, [*given, *own])


def _candidates(name: str, path: Path, given: Sequence[Path], above: Sequence[Path]) -> list[Path]:
    """Return the files that `name` may mean in the URDF file at `path`, most likely first."""
    scheme, separated, rest = name.partition("://")
    if not separated:
        return [path.resolve().parent / name]
    if scheme == "file":
        plain = re.sub(rb"%([0-9a-fA-F]{2})", lambda code: bytes.fromhex(code[1].decode()), os.fsencode(rest))
        return [path.resolve().parent / os.fsdecode(plain).removeprefix("localhost")]
    package, _, inner = rest.partition("/")
    if scheme not in ("package", "model") or not inner:
        return []
    folders = [*given, *above]
    if not package:  # package:///a/b, which Pinocchio reads from its package_dirs
        return [folder / inner.lstrip("/") for folder in folders]
    roots = [folder / package for folder in folders]
    roots += [folder for folder in folders if package in (folder.name, _package_name(folder))]
    roots += [
        child for folder in _holding(given, above) for child in _children(folder) if _package_name(child) == package
    ]
    return [root / inner for root in roots if os.path.isdir(root)]


def packages_around(path: Path, package_dirs: Iterable[str | os.PathLike[str]]) -> dict[str, Path]:
    """Return the packages that the file at `path` may name, by name: the same as in `settle_meshes`."""
    given, above = [Path(folder) for folder in package_dirs], list(path.resolve().parents)
    around = [child for folder in _holding(given, above) for child in _children(folder)] + above[::-1] + given
    return {name: folder for folder in around if (name := _package_name(folder)) is not None}


def _holding(given: Sequence[Path], above: Sequence[Path]) -> list[Path]:
    """Return the folders whose own folders may be packages: those `given`, and that of the robot's own package."""
    own = next((folder for folder in above if _package_name(folder) is not None), None)
    return [*given, *([own.parent] if own is not None else [])]


def _advice(name: str, path: Path, given: Sequence[Path], candidates: Sequence[Path]) -> str:
    scheme, _, rest = name.partition("://")
    package, _, inner = rest.partition("/")
    if scheme not in ("package", "model") or not package or not inner:
        return f"there is no file '{candidates[0]}'" if candidates else "give a path, file://... or package://NAME/..."
    if candidates:
        places = " and ".join(f"'{str(file)[: -len(inner) - 1]}'" for file in candidates)
        return f"package '{package}' is {places}, without '{inner}'"
    looked = "".join(f"'{folder}', in what is directly in it, and in " for folder in given)
    return (
        f"looked for package '{package}' in {looked}the folders above the URDF file; add to package_dirs the folder "
        f"whose package.xml says <name>{package}</name>, or the one that holds it"
    )


def _children(folder: Path) -> list[Path]:
    try:
        return sorted(child for child in folder.iterdir() if child.is_dir())
    except OSError:
        return []


@cache
def _package_name(folder: Path) -> str | None:
    """Return the name in the package.xml of `folder`, or None."""
    try:
        return (parse_xml((folder / "package.xml").read_bytes()).findtext("name") or "").strip() or None
    except (OSError, ValueError):
        return None
