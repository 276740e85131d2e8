"""`E`, `Q_pair` (Eq. 4) and `J_seq` (Eq. 5) of a chain of poses as CasADi functions with derivatives of their own.

The poses of a chain move with planar parameters or are full poses; a fixed end is known by its energies, which are
numbers or an input. `parametric_functions` leaves everything that belongs to one problem open, so that one solver
object serves every problem with the same N and the same number of grasps.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.connectivity.casadi_chain import Chain, cost_of_scores, pair_score
from regrasp_opt.connectivity.costs import CostOptions
from regrasp_opt.connectivity.objective import BLOCKED
from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.energy.casadi_blocks import FixedEnergy, FreeEnergy, PoseEnergy, full_pose_energy, planar_energy
from regrasp_opt.energy.casadi_energy import Blas, CasadiEnergy
from regrasp_opt.energy.casadi_function import by_adjoint, by_jacobian
from regrasp_opt.energy.model import GraspEnergy, PlanarLayer

INPUT: Literal["input"] = "input"
"""Stands for an end or a mask that is an input of the functions instead of a constant."""


class ConnectivityFunctions(NamedTuple):
    """`E`, `Q_pair` and `J_seq` of one chain of poses as `casadi.Function`; see `ProblemEnergy.casadi_functions`."""

    E: Any
    Q_pair: Any
    J_seq: Any


@dataclass(frozen=True, eq=False)
class ChainEnds:
    """What a chain is made of besides its moving poses.

    Attributes
    ----------
    start, goal : (G,) energies, "input", or None
        None: the chain begins, or ends, with a moving pose.
    mask : "input" or None
        "input": the functions take a mask (G, 1), 1 for grasps that may be used and 0 for others.
    grasp_ids : (A,), optional
        The grasps that pairs are scored by; all by default.
    """

    start: Any = None
    goal: Any = None
    mask: Any = None
    grasp_ids: IntArray | None = None


@dataclass(frozen=True, eq=False)
class _Moving:
    """The moving poses: their inputs by name, the first of which is differentiated in, and how to make them."""

    inputs: Mapping[str, Any]
    make: Callable[[IntArray, bool], list[PoseEnergy]]


def planar_functions(
    energy: GraspEnergy, options: CostOptions, ends: ChainEnds, placements: FloatArray, blas: Blas = "classic"
) -> ConnectivityFunctions:
    """Return the functions of ``xi`` (3, N), planar parameters [m, m, rad] at `placements` (N, 4, 4)."""
    xi = ca.MX.sym("xi", 3, len(placements))

    def make(ids: IntArray, tangents: bool) -> list[PoseEnergy]:
        expressions = CasadiEnergy(energy.model, len(ids), blas)
        layers = [expressions.layer(energy.planar_layer(T, ids)) for T in placements]
        return [planar_energy(expressions, layer, xi[:, i], tangents=tangents) for i, layer in enumerate(layers)]

    return _functions(_Moving({"xi": xi}, make), len(energy), options, ends)


def pose_functions(
    energy: GraspEnergy, options: CostOptions, ends: ChainEnds, num_poses: int, blas: Blas = "classic"
) -> ConnectivityFunctions:
    """Return the functions of ``T`` (4, 4 M), `num_poses` full poses T_world_object side by side."""
    T = ca.MX.sym("T", 4, 4 * num_poses)

    def make(ids: IntArray, tangents: bool) -> list[PoseEnergy]:
        expressions = CasadiEnergy(energy.model, len(ids), blas)
        parts = ca.horzsplit(T, 4)
        return [full_pose_energy(expressions, energy, part, ids, tangents=tangents) for part in parts]

    return _functions(_Moving({"T": T}, make), len(energy), options, ends)


def parametric_functions(energy: CasadiEnergy, options: CostOptions, num_regrasps: int) -> ConnectivityFunctions:
    """Return the functions of ``xi`` (3, N), ``layers`` (H, 3 G N), ``start`` and ``goal`` (G, 1).

    They are differentiable in ``xi`` only; `layers_parameter` makes ``layers``.
    """
    xi, packed = ca.MX.sym("xi", 3, num_regrasps), _layers_symbol(energy, num_regrasps)

    def make(ids: IntArray, tangents: bool) -> list[PoseEnergy]:
        layers = _split(energy, packed)
        return [planar_energy(energy, layer, xi[:, i], tangents=tangents) for i, layer in enumerate(layers)]

    moving = _Moving({"xi": xi, "layers": packed}, make)
    return _functions(moving, energy.count, options, ChainEnds(INPUT, INPUT), free_ends=False)


def plain_sequence_cost(energy: CasadiEnergy, options: CostOptions, num_regrasps: int) -> Any:
    """Return ``J_seq`` of `parametric_functions` built without derivatives of its own: the reference for them."""
    xi, packed = ca.MX.sym("xi", 3, num_regrasps), _layers_symbol(energy, num_regrasps)
    ends = [ca.MX.sym(name, energy.count) for name in ("start", "goal")]
    energies = [energy.planar_expression(layer, xi[:, i]) for i, layer in enumerate(_split(energy, packed))]
    chain = [ends[0], *energies, ends[1]]
    scores = [pair_score(a, b, options) for a, b in itertools.pairwise(chain)]
    cost = cost_of_scores(scores, options.regularisation)
    return ca.Function("J_seq_plain", [xi, packed, *ends], [cost], ["xi", "layers", "start", "goal"], ["J"])


def layers_parameter(energy: GraspEnergy, placements: FloatArray, grasp_ids: Any = slice(None)) -> FloatArray:
    """Return the ``layers`` input (H, 3 G N) of the chosen grasps at `placements` (N, 4, 4)."""
    layers = [np.concatenate(energy.planar_layer(T, grasp_ids)[:3], axis=1) for T in placements]
    return np.concatenate(layers, axis=1) if layers else np.zeros((energy.model.hidden, 0))


def _layers_symbol(energy: CasadiEnergy, num_regrasps: int) -> Any:
    return ca.MX.sym("layers", energy.model.hidden, 3 * energy.count * num_regrasps)


def _split(energy: CasadiEnergy, layers: Any) -> list[PlanarLayer]:
    return [energy.layer_parameter(part) for part in ca.horzsplit(layers, 3 * energy.count)]


def _functions(
    moving: _Moving, count: int, options: CostOptions, ends: ChainEnds, *, free_ends: bool = True
) -> ConnectivityFunctions:
    ids = np.arange(count) if ends.grasp_ids is None else np.asarray(ends.grasp_ids)
    inputs, fixed = dict(moving.inputs), dict[str, PoseEnergy]()
    spans = {next(iter(inputs)): next(iter(inputs.values())).numel()}
    for name, end in (("start", ends.start), ("goal", ends.goal)):
        if isinstance(end, str):
            symbol = inputs[name] = ca.MX.sym(name, count)
            fixed[name] = FreeEnergy(symbol, ids) if free_ends else FixedEnergy(symbol)
            if free_ends:
                spans = {name: count, **spans} if name == "start" else {**spans, name: count}
        elif end is not None:
            fixed[name] = FixedEnergy(ca.MX(ca.DM(np.asarray(end)[ids])))
    penalty = 0
    if ends.mask is not None:
        inputs["mask"] = ca.MX.sym("mask", count)
        penalty = BLOCKED * (1 - inputs["mask"][ids.tolist()])
    light, full = (
        [*_one(fixed.get("start")), *moving.make(ids, tangents), *_one(fixed.get("goal"))] for tangents in (False, True)
    )
    return ConnectivityFunctions(_energies(moving, count), *_scores(inputs, spans, options, penalty, (light, full)))


def _scores(
    inputs: Mapping[str, Any],
    spans: Mapping[str, int],
    options: CostOptions,
    penalty: Any,
    poses: tuple[list[PoseEnergy], list[PoseEnergy]],
) -> tuple[Any, Any]:
    """Return ``Q_pair`` and ``J_seq`` of `poses` without and with tangents; `spans` are their variables' numbers."""
    chain = Chain(poses[0], options, penalty)
    scores = ca.vertcat(*chain.scores) if chain.scores else ca.MX(0, 1)
    if options.variant == "Jh":  # no useful derivative where no grasp is shared
        arguments = [*inputs.values()], [*inputs]
        return (
            ca.Function("Q_pair", arguments[0], [scores], arguments[1], ["Q"]),
            ca.Function("J_seq", arguments[0], [chain.cost], arguments[1], ["J"]),
        )
    bent, own = Chain(poses[1], options, penalty), _places(spans)
    gradient, hessian, slopes = chain.gradient(), bent.hessian(), bent.score_jacobian()
    return (
        by_jacobian(
            "Q_pair",
            inputs,
            "Q",
            scores,
            {name: slopes[:, place] for name, place in own.items()},
            {(a, b): _interleaved([h[own[a], own[b]] for h in bent.score_hessians()]) for a in own for b in own},
        ),
        by_jacobian(
            "J_seq",
            inputs,
            "J",
            chain.cost,
            {name: gradient[place].T for name, place in own.items()},
            {(a, b): hessian[own[a], own[b]] for a in own for b in own},
        ),
    )


def _energies(moving: _Moving, count: int) -> Any:
    """Return ``E`` (G, M) of the moving poses."""
    light, full = (moving.make(np.arange(count), tangents) for tangents in (False, True))
    name, variable = next(iter(moving.inputs.items()))
    seed, unweighted = ca.MX.sym("adj_E", count, len(light)), ca.MX.ones(count)
    weights = ca.horzsplit(seed) if light else []
    gradients = [pose.gradient(w) for pose, w in zip(light, weights, strict=True)]
    return by_adjoint(
        "E",
        moving.inputs,
        "E",
        ca.horzcat(*[pose.energy for pose in light]) if light else ca.MX(count, 0),
        {name: ca.diagcat(*[pose.second(unweighted)[0] for pose in full])},
        seed,
        {name: ca.reshape(ca.vertcat(*gradients), *variable.shape)},
        {name: ca.diagcat(*[pose.second(w)[1] for pose, w in zip(full, weights, strict=True)])},
    )


def _places(spans: Mapping[str, int]) -> dict[str, slice]:
    """Return where each input's variables stand, from their numbers in the order of the variables."""
    edges = itertools.pairwise(itertools.accumulate(spans.values(), initial=0))
    return {name: slice(*edge) for name, edge in zip(spans, edges, strict=True)}


def _interleaved(blocks: list[Any]) -> Any:
    """Return the rows of equal blocks (k, n) one after the other: first rows, second rows, and so on."""
    if not blocks:
        return ca.MX(0, 0)
    order = np.arange(blocks[0].shape[0] * len(blocks)).reshape(len(blocks), -1).T.ravel()
    return ca.vertcat(*blocks)[order.tolist(), :]


def _one(pose: PoseEnergy | None) -> list[PoseEnergy]:
    return [] if pose is None else [pose]
