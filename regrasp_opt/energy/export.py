"""The energy outside Python: as a stored CasADi function, as C without dependencies, or as ONNX.

All three map an object pose T_world_object to the energies of the G grasps of one set. CasADi and C take the (4, 4)
pose and give (G, 1); ONNX takes a batch ``T`` (B, 3, 4) of upper pose rows and gives ``E`` (B, G) in single precision.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import count
from typing import Any

import casadi as ca
import numpy as np

from regrasp_opt.energy.casadi_energy import Blas, CasadiEnergy
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.energy.network import Activation, evaluate
from regrasp_opt.errors import ModelError
from regrasp_opt.files import atomic_path


def pose_function(energy: GraspEnergy, blas: Blas = "classic") -> Any:
    """Return `casadi.Function` ``energy(T) -> E`` from a full pose (4, 4) to energies (G, 1)."""
    T = ca.MX.sym("T", 4, 4)
    expression = CasadiEnergy(energy.model, len(energy), blas).pose_expression(energy, T)
    return ca.Function("energy", [T], [expression], ["T"], ["E"])


def grasp_function(model: EnergyModel) -> Any:
    """Return `casadi.Function` ``E(T, g, width)`` of one grasp whose own pose is a variable.

    Inputs are the object pose ``T`` (4, 4) T_world_object, the grasp ``g`` (4, 4) T_object_tcp and its jaw width [m];
    the output is the energy (1, 1). It can be differentiated in all of them.
    """
    T, g, width = ca.MX.sym("T", 4, 4), ca.MX.sym("g", 4, 4), ca.MX.sym("width")
    energy = CasadiEnergy(model, 1).grasp_expression(T, g, width)
    return ca.Function("grasp_energy", [T, g, width], [energy], ["T", "g", "width"], ["E"])


def export_casadi(energy: GraspEnergy, path: str | os.PathLike[str]) -> None:
    """Write the function for ``casadi.Function.load``."""
    with atomic_path(path) as temporary:
        pose_function(energy, "reference").save(str(temporary))


def export_c(energy: GraspEnergy, path: str | os.PathLike[str]) -> None:
    """Write C source that any C compiler builds without other libraries (CasADi's C API, function ``energy``)."""
    code = ca.CodeGenerator("energy.c", {"with_header": False})
    code.add(pose_function(energy, "reference"))
    with atomic_path(path) as temporary:
        temporary.write_text(code.dump(), encoding="utf-8")


def export_onnx(energy: GraspEnergy, path: str | os.PathLike[str]) -> None:
    """Write an ONNX graph; a `ModelError` says if the package ``onnx`` is not installed."""
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ImportError as error:
        raise ModelError("ONNX export needs the package 'onnx'; install regrasp-opt[onnx]") from error

    model, first = energy.model, energy.first_layer
    nodes: list[Any] = []
    constants: list[Any] = []

    def constant(name: str, value: Any) -> str:
        constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def floats(name: str, value: Any) -> str:
        return constant(name, np.asarray(value, dtype=np.float32))

    size = len(energy)
    flat = node("Reshape", ["T", constant("shape_flat", np.array([-1, 1, 12]))], "flat")
    z = node("MatMul", [flat, floats("W_pose", first.pose.transpose(0, 2, 1).reshape(12, -1))], "z_pose")
    z = node("Add", [z, floats("z_grasp", first.constant.T)], "z_0")
    if first.tcp.any():
        grasps = energy.grasps.T_object_tcp.transpose(1, 0, 2).reshape(4, -1)
        tcp = node("MatMul", ["T", floats("grasps", grasps)], "tcp_rows")
        tcp = node("Reshape", [tcp, constant("shape_tcp", np.array([-1, 3, size, 4]))], "tcp_split")
        tcp = node("Transpose", [tcp], "tcp_by_grasp", perm=[0, 2, 1, 3])
        tcp = node("Reshape", [tcp, constant("shape_tcp_flat", np.array([-1, size, 12]))], "tcp_flat")
        weights = floats("W_tcp", first.tcp.transpose(0, 2, 1).reshape(12, -1))
        z = node("Add", [z, node("MatMul", [tcp, weights], "z_tcp")], "z_1")
    last = evaluate(_Onnx(node, floats), model.layers, model.activation, model.bounded, z)
    node("Reshape", [last, constant("shape_out", np.array([-1, size]))], "E")
    pose = helper.make_tensor_value_info("T", TensorProto.FLOAT, ["B", 3, 4])
    out = helper.make_tensor_value_info("E", TensorProto.FLOAT, ["B", size])
    graph = helper.make_graph(nodes, "regrasp_energy", [pose], [out], constants)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    checker.check_model(made)
    with atomic_path(path) as temporary:
        temporary.write_bytes(made.SerializeToString())


class _Onnx:
    """Names of ONNX values (..., H); a network's backend that adds nodes to a graph."""

    def __init__(self, node: Callable[..., str], floats: Callable[[str, Any], str]) -> None:
        self._node, self._floats, self._numbers = node, floats, count()

    def activate(self, name: Activation, z: str) -> str:
        i = next(self._numbers)
        if name == "silu":
            return self._node("Mul", [z, self._node("Sigmoid", [z], f"sigmoid_{i}")], f"silu_{i}")
        return self._node({"selu": "Selu", "tanh": "Tanh"}[name], [z], f"{name}_{i}")

    def affine(self, a: str, W: Any, b: Any) -> str:
        i = next(self._numbers)
        product = self._node("MatMul", [a, self._floats(f"W_{i}", W.T)], f"product_{i}")
        return self._node("Add", [product, self._floats(f"b_{i}", b)], f"sum_{i}")

    def softplus(self, f: str) -> str:
        return self._node("Softplus", [f], "bounded")


EXPORTERS = {"casadi": export_casadi, "c": export_c, "onnx": export_onnx}
SUFFIXES = {"casadi": ".casadi", "c": ".c", "onnx": ".onnx"}
