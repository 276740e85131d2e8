"""Xacro files, expanded to URDF by ``xacrodoc``, which needs no ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from regrasp_opt.errors import WorkcellError
from regrasp_opt.files import captured_stderr
from regrasp_opt.robots import urdf
from regrasp_opt.robots.mesh_names import packages_around


class Arguments(dict[str, str]):
    """Arguments for xacro, which puts those that the file declares in here; `asked` are the names it looked for."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.asked: set[object] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(name)
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


def expand_xacro(path: Path, arguments: Mapping[str, str], package_dirs: Iterable[Path]) -> bytes:
    """Return the URDF that the xacro file at `path` makes with `arguments`.

    ``$(find NAME)`` means the same packages as ``package://NAME`` does.

    Raises
    ------
    WorkcellError
        If xacrodoc is not installed or cannot expand the file, or the file has no argument of a name in `arguments`.
    """
    try:
        from xacrodoc import XacroDoc, packages
    except ImportError as error:
        raise WorkcellError(
            f"{path} is a xacro file; install the extra regrasp-opt[robots], or expand it to a URDF file"
        ) from error
    packages.reset()
    packages.update_package_cache(packages_around(path, package_dirs))
    known = Arguments(arguments)
    try:
        with captured_stderr():
            document = XacroDoc.from_file(path, subargs=known, resolve_packages=False)
    except Exception as error:  # xacro evaluates expressions, which raise whatever Python does
        reason = " ".join(str(error).split()) or type(error).__name__
        raise WorkcellError(f"xacro file {path} cannot be expanded: {reason}") from error
    unknown = next((name for name in arguments if name not in known.asked), None)
    if unknown is not None:
        others = [name for name in known if name in known.asked]
        said = f"known: {', '.join(urdf.closest(unknown, others))}" if others else "it has none; leave xacro_args out"
        raise WorkcellError(f"xacro file {path} has no argument '{unknown}' to give in xacro_args; {said}")
    return str(document.dom.toxml()).encode()
