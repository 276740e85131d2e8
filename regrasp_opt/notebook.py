"""How plans and motions show themselves in a notebook: as their page, which is drawn by a layer above them.

The package's `__init__` fills in `drawing`, so that whoever imported any part of the package gets the page.
"""

from __future__ import annotations

import html
from collections.abc import Callable

HEIGHT = 600
"""Height of the page in a cell [px]."""
drawing: list[Callable[[object], str]] = []
"""What returns the page (HTML) of a plan or a motion."""


class PageInNotebook:
    """An object that a notebook shows as its page."""

    def _repr_html_(self) -> str:
        """Return the page in a frame of its own; its script reaches nothing of the notebook."""
        page = html.escape(drawing[0](self))
        return (
            f'<iframe srcdoc="{page}" sandbox="allow-scripts" width="100%" height="{HEIGHT}" '
            'style="border:0" title="regrasp plan"></iframe>'
        )
