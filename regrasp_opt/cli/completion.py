"""What the shell offers after an option: names that come with the package, found without loading anything large."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files

OBJECTS = ("bottle", "figurine", "mug", "pentagon")
REFINERS = ("exact", "ipopt", "langevin", "langevin-ipopt", "lattice", "paper")
EXPERIMENTS = (
    *("ablations", "any", "arms", "cost-sweep", "cross-effector", "hard-tiers", "joint", "motion"),
    *("multi-step", "one-step", "refiners", "speed", "unseen"),
)

Completion = Callable[[str], list[str]]


def names(known: tuple[str, ...]) -> Completion:
    """Return a completion that offers `known` names."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in known if name.startswith(incomplete)]

    return complete


def stored(folder: str) -> Completion:
    """Return a completion that offers the names of what `folder` of the package's data holds."""

    def complete(incomplete: str) -> list[str]:
        items = (files("regrasp_opt") / "data" / folder).iterdir()
        found = sorted(item.name.removesuffix(".toml") for item in items)
        return [name for name in found if name.startswith(incomplete)]

    return complete
