"""Collision queries that miss no overlap, and whose answers do not depend on what was asked before."""

from __future__ import annotations

import warnings
from typing import Any

from regrasp_opt.conventions import FloatArray


def settle_queries(data: Any, margins: FloatArray) -> None:
    """Set up all queries of a `pin.GeometryData` for the least allowed distances `margins`, one a pair [m].

    Two defaults are changed. GJK would start from the last result, so that answers depend on the order of questions.
    And bodies that overlap by up to a millimetre would pass for apart now and then: where GJK ends because they are
    nearer than its tolerance, its distance is a little above zero; with contacts asked for, EPA measures the overlap.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for request in (*data.collisionRequests, *data.distanceRequests):
            request.enable_cached_gjk_guess = False
        for request, margin in zip(data.collisionRequests, margins, strict=True):
            request.enable_contact = True
            request.security_margin = float(margin)
