"""Every error that regrasp-opt raises on purpose.

Each message is one sentence that names what is wrong and what to do; the data behind it is on the exception.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class RegraspError(Exception):
    """Root of all errors of this package. The command line prints it in one line and exits with 2."""


class UnknownNameError(RegraspError):
    """An unknown name.

    Attributes
    ----------
    kind : str
        What was looked up, for example ``"object"``.
    name : str
        The name that was asked for.
    alternatives : tuple of str
        The known names, the closest first.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        known = sorted(known)
        close = difflib.get_close_matches(name, known, n=len(known), cutoff=0.4)
        self.alternatives = (*close, *(other for other in known if other not in close))
        super().__init__(f"unknown {kind} '{name}'; known: {', '.join(self.alternatives)}")


class MeshError(RegraspError):
    """A mesh that is not a usable solid; the message names a repair if there is one."""


class PoseError(RegraspError):
    """An object pose that is not a rigid transform, or that the object cannot have in this workcell."""


class WorkcellError(RegraspError):
    """A workcell, end-effector or robot description with a wrong key, value or geometry."""


class HomeCollisionError(WorkcellError):
    """A workcell in which the arm collides where it rests.

    Attributes
    ----------
    workcell : Workcell
        What was understood of it.
    """

    def __init__(self, message: str, workcell: Any) -> None:
        self.workcell = workcell
        super().__init__(message)


class GraspError(RegraspError):
    """No grasp of the end-effector fits the object, or a grasp set is malformed."""


class ModelError(RegraspError):
    """A trained model that is missing, corrupt, or was made for another object, workcell or grasp set."""


class PlanFileError(RegraspError):
    """A plan file that cannot be read, or whose schema version is unknown."""


class OptionError(RegraspError, ValueError):
    """An option outside its range."""
