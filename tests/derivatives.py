"""The one finite-difference check that every derivative of the project runs through."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def assert_derivative(function: Callable, derivative: np.ndarray, x: np.ndarray, step=1e-6, tolerance=1e-6) -> None:
    """Assert that `derivative` (..., n) is the central difference of `function` (n,) -> (...) at `x` (n,)."""
    columns = []
    for i in range(len(x)):
        shift = np.zeros(len(x))
        shift[i] = step
        columns.append((np.asarray(function(x + shift)) - np.asarray(function(x - shift))) / (2 * step))
    expected = np.stack(columns, axis=-1)
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(derivative, expected, atol=tolerance * scale, rtol=0)
