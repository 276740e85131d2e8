"""The energy of one grasp whose own pose is a variable, as a CasADi function."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from regrasp_opt.energy.activations import casadi_activation
from regrasp_opt.energy.model import EnergyModel


def free_grasp_function(model: EnergyModel) -> Any:
    """Return the `casadi.Function` ``E(T, g, width)`` of `model`.

    Inputs are the object pose ``T`` (4, 4) T_world_object, the grasp ``g`` (4, 4) T_object_tcp and its jaw width [m];
    the output is the energy (1, 1). It can be differentiated in all of them.
    """
    T, g, width = ca.MX.sym("T", 4, 4), ca.MX.sym("g", 4, 4), ca.MX.sym("width")
    parts = [_rows(T), _rows(g)]
    if model.features == "tcp":
        parts.append(_rows(T @ g))
    if model.use_width:
        parts.append(width)
    z: Any = ca.vertcat(*parts)
    for number, (W, b) in enumerate(zip(model.weights, model.biases, strict=True)):
        z = z if number == 0 else casadi_activation(model.activation, z).value
        z = ca.DM(W.astype(np.float64)) @ z + ca.DM(b.astype(np.float64))
    energy = ca.fmax(z, 0) + ca.log1p(ca.exp(-ca.fabs(z))) if model.bounded else z
    return ca.Function("free_energy", [T, g, width], [energy], ["T", "g", "width"], ["E"])


def _rows(T: Any) -> Any:
    """Return the upper three rows of a transform, row by row (12, 1)."""
    return ca.vec(T[:3, :].T)
