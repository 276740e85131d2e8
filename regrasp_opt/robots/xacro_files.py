"""Xacro files, expanded to URDF by ``xacrodoc``, which needs no ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from regrasp_opt.errors import WorkcellError
from regrasp_opt.files import captured_stderr
from regrasp_opt.robots.mesh_names import packages_around


def expand_xacro(path: Path, arguments: Mapping[str, str], package_dirs: Iterable[Path]) -> bytes:
    """Return the URDF that the xacro file at `path` makes with `arguments`.

    ``$(find NAME)`` means the same packages as ``package://NAME`` does.

    Raises
    ------
    WorkcellError
        If xacrodoc is not installed, or cannot expand the file.
    """
    try:
        from xacrodoc import XacroDoc, packages
    except ImportError as error:
        raise WorkcellError(
            f"{path} is a xacro file; install the extra regrasp-opt[robots], or expand it to a URDF file"
        ) from error
    packages.reset()
    packages.update_package_cache(packages_around(path, package_dirs))
    try:
        with captured_stderr():
            document = XacroDoc.from_file(path, subargs=dict(arguments), resolve_packages=False)
    except Exception as error:  # xacro evaluates expressions, which raise whatever Python does
        reason = " ".join(str(error).split()) or type(error).__name__
        raise WorkcellError(f"xacro file {path} cannot be expanded: {reason}") from error
    return str(document.dom.toxml()).encode()
