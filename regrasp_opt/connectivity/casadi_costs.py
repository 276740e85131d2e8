"""`E`, `Q_pair` (Eq. 4) and `J_seq` (Eq. 5) of a chain of poses as CasADi functions with derivatives of their own.

The poses of a chain move with planar parameters or are full poses; a fixed end is known by its energies, which are
numbers or an input. `parametric_functions` leaves everything that belongs to one problem open, so that one solver
object serves every problem with the same N and the same number of grasps.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from regrasp_opt.connectivity.casadi_chain import Chain, cost_of_scores, pair_score
from regrasp_opt.connectivity.costs import CostOptions
from regrasp_opt.connectivity.objective import BLOCKED
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.energy import casadi_blocks as blocks
from regrasp_opt.energy.casadi_blocks import PoseEnergy, planar_energy
from regrasp_opt.energy.casadi_energy import Blas, CasadiEnergy
from regrasp_opt.energy.casadi_function import by_adjoint, by_jacobian
from regrasp_opt.energy.model import GraspEnergy, PlanarLayer
from regrasp_opt.geometry.planar_poses import PlanarPoses

INPUT: Literal["input"] = "input"
"""Stands for an end or a mask that is an input of the functions instead of a constant."""


@dataclass(frozen=True, eq=False)
class ChainEnds:
    """What a chain is made of besides its moving poses.

    `start` and `goal` are (G,) energies, "input", or None: then the chain begins, or ends, with a moving pose. With a
    `mask` of "input" the functions take a mask (G, 1), 1 for grasps that may be used and 0 for others. Pairs are scored
    by the grasps `grasp_ids` (A,), by default all. `blocked` (M, G) are the grasps known to be infeasible at each
    moving pose: their energy there is `BLOCKED`.
    """

    start: Any = None
    goal: Any = None
    mask: Any = None
    grasp_ids: IntArray | None = None
    blocked: BoolArray | None = None


@dataclass(frozen=True, eq=False)
class _Moving:
    """The moving poses: the functions' inputs, the one among them that moves the poses, and how to make them.

    ``make(ids, tangents)`` returns them with the grasps `ids`; `tangents` same as in `planar_energy`. Derivatives are
    written for poses side by side; callers hand them over one below the other, in an array of ``shape`` which
    ``columns`` turns around.
    """

    inputs: Mapping[str, Any]
    variable: str
    make: Callable[[IntArray, bool], list[PoseEnergy]]
    shape: tuple[int, int]
    columns: Callable[[Any], Any]


class ConnectivityFunctions:
    """``E``, ``Q_pair`` and ``J_seq`` of one chain of poses, each built when it is first asked for.

    Unpacks as ``E, Q_pair, J_seq``; see `ProblemEnergy.casadi_functions`.
    """

    def __init__(
        self, moving: _Moving, count: int, options: CostOptions, ends: ChainEnds, *, free_ends: bool = True
    ) -> None:
        self._moving, self._count, self._options = moving, count, options
        self._blocked = ends.blocked
        self._ids = np.arange(count) if ends.grasp_ids is None else np.asarray(ends.grasp_ids)
        self._inputs, self._fixed = dict(moving.inputs), dict[str, PoseEnergy]()
        self._spans = {moving.variable: moving.inputs[moving.variable].numel()}
        for name, end in (("start", ends.start), ("goal", ends.goal)):
            if end is not None:
                self._fixed[name] = self._end(name, end, free_ends)
        self._penalty: Any = 0
        if ends.mask is not None:
            mask = self._inputs["mask"] = ca.MX.sym("mask", count)
            self._penalty = BLOCKED * (1 - mask[self._ids.tolist()])

    def __iter__(self) -> Iterator[Any]:
        return iter((self.E, self.Q_pair, self.J_seq))

    @cached_property
    def E(self) -> Any:
        """Energies (M, G) of the moving poses."""
        moving = self._moving
        light, full = (self._poses(np.arange(self._count), tangents) for tangents in (False, True))
        name, shape = moving.variable, moving.inputs[moving.variable].shape
        seed, unweighted = ca.MX.sym("adj_E", self._count, len(light)), ca.MX.ones(self._count)
        weights = ca.horzsplit(seed) if light else []
        gradients = [pose.gradient(w) for pose, w in zip(light, weights, strict=True)]
        columns = by_adjoint(
            "E",
            moving.inputs,
            "E",
            ca.horzcat(*[pose.energy for pose in light]) if light else ca.MX(self._count, 0),
            {name: ca.diagcat(*[pose.second(unweighted)[0] for pose in full])},
            seed,
            {name: ca.reshape(ca.vertcat(*gradients), *shape)},
            {name: ca.diagcat(*[pose.second(w)[1] for pose, w in zip(full, weights, strict=True)])},
        )
        return self._rows_first(columns, transposed=True)

    @cached_property
    def Q_pair(self) -> Any:
        """Pair scores of neighbouring poses (Eq. 4)."""
        scores = self._light.scores
        value = ca.vertcat(*scores) if scores else ca.MX(0, 1)
        if self._options.variant == "Jh":
            return self._plain("Q_pair", "Q", value)
        own, rows, hessians = self._places, self._full.score_jacobian(), self._full.score_hessians()
        jacobian = {name: rows[:, place] for name, place in own.items()}
        second = {(a, b): _interleaved([h[own[a], own[b]] for h in hessians]) for a in own for b in own}
        return self._rows_first(by_jacobian("Q_pair", self._inputs, "Q", value, jacobian, second))

    @cached_property
    def J_seq(self) -> Any:
        """The cost of the chain (Eq. 5)."""
        if self._options.variant == "Jh":
            return self._plain("J_seq", "J", self._light.cost)
        own, gradient, hessian = self._places, self._light.gradient(), self._full.hessian()
        jacobian = {name: gradient[place].T for name, place in own.items()}
        second = {(a, b): hessian[own[a], own[b]] for a in own for b in own}
        return self._rows_first(by_jacobian("J_seq", self._inputs, "J", self._light.cost, jacobian, second))

    def _end(self, name: str, end: Any, free: bool) -> PoseEnergy:
        """Return a fixed end, made an input where it is one; a free one counts among the variables."""
        if not isinstance(end, str):
            return blocks.FixedEnergy(ca.MX(ca.DM(np.asarray(end)[self._ids])))
        symbol = self._inputs[name] = ca.MX.sym(name, self._count)
        if not free:
            return blocks.FixedEnergy(symbol)
        own = {name: self._count}
        self._spans = {**own, **self._spans} if name == "start" else {**self._spans, **own}
        return blocks.FreeEnergy(symbol, self._ids)

    def _plain(self, name: str, output: str, value: Any) -> Any:
        """Return a function without derivatives of its own: the truncated cost has no useful ones."""
        return self._rows_first(ca.Function(name, [*self._inputs.values()], [value], [*self._inputs], [output]))

    def _rows_first(self, function: Any, *, transposed: bool = False) -> Any:
        """Return `function` of poses one below the other, inlined wherever it is called; its output may be turned."""
        names = function.name_in()
        inputs = {name: ca.MX.sym(name, *function.size_in(name)) for name in names}
        variable = inputs[self._moving.variable] = ca.MX.sym(self._moving.variable, *self._moving.shape)
        called = {**inputs, self._moving.variable: self._moving.columns(variable)}
        output = function(*called.values())
        return ca.Function(
            function.name(),
            [*inputs.values()],
            [output.T if transposed else output],
            names,
            function.name_out(),
            {"always_inline": True, "is_diff_in": function.is_diff_in()},
        )

    @cached_property
    def _light(self) -> Chain:
        return self._chain(tangents=False)

    @cached_property
    def _full(self) -> Chain:
        return self._chain(tangents=True)

    def _chain(self, *, tangents: bool) -> Chain:
        poses = self._poses(self._ids, tangents)
        if "start" in self._fixed:
            poses = [self._fixed["start"], *poses]
        if "goal" in self._fixed:
            poses = [*poses, self._fixed["goal"]]
        return Chain(poses, self._options, self._penalty)

    def _poses(self, ids: IntArray, tangents: bool) -> list[PoseEnergy]:
        poses = self._moving.make(ids, tangents)
        if self._blocked is None:
            return poses
        known = zip(poses, self._blocked[:, ids], strict=True)
        return [
            blocks.PartlyKnownEnergy(pose, ca.MX(ca.DM(row.astype(np.float64))), BLOCKED) if row.any() else pose
            for pose, row in known
        ]

    @property
    def _places(self) -> dict[str, slice]:
        """Where each input stands among the variables, pose by pose."""
        edges = itertools.pairwise(itertools.accumulate(self._spans.values(), initial=0))
        return {name: slice(*edge) for name, edge in zip(self._spans, edges, strict=True)}


def _interleaved(parts: list[Any]) -> Any:
    """Return the rows of equal blocks (k, n) one after the other: first rows, second rows, and so on."""
    if not parts:
        return ca.MX(0, 0)
    order = np.arange(parts[0].shape[0] * len(parts)).reshape(len(parts), -1).T.ravel()
    return ca.vertcat(*parts)[order.tolist(), :]


def planar_functions(
    energy: GraspEnergy, options: CostOptions, ends: ChainEnds, placements: PlanarPoses, blas: Blas = "classic"
) -> ConnectivityFunctions:
    """Return the functions of ``xi`` (N, 3), planar parameters [m, m, rad] at N `placements`."""
    xi = ca.MX.sym("xi", 3, len(placements))

    def make(ids: IntArray, tangents: bool) -> list[PoseEnergy]:
        expressions = CasadiEnergy(energy.model, len(ids), blas)
        layers = [expressions.layer(layer) for layer in energy.planar_layers(placements, ids)]
        return [planar_energy(expressions, layer, xi[:, i], tangents=tangents) for i, layer in enumerate(layers)]

    return ConnectivityFunctions(_planar({"xi": xi}, make), len(energy), options, ends)


def pose_functions(
    energy: GraspEnergy, options: CostOptions, ends: ChainEnds, num_poses: int, blas: Blas = "classic"
) -> ConnectivityFunctions:
    """Return the functions of ``T`` (4 M, 4), `num_poses` full poses T_world_object one below the other."""
    T = ca.MX.sym("T", 4, 4 * num_poses)

    def make(ids: IntArray, tangents: bool) -> list[PoseEnergy]:
        expressions = CasadiEnergy(energy.model, len(ids), blas)
        parts = ca.horzsplit(T, 4)
        bottoms = [expressions.pose_bottom(energy, part, ids) for part in parts]
        return [blocks.FullPoseEnergy(expressions, bottom, tangents) for bottom in bottoms]

    def columns(rows: Any) -> Any:
        return ca.horzcat(*ca.vertsplit(rows, 4))

    moving = _Moving({"T": T}, "T", make, (4 * num_poses, 4), columns)
    return ConnectivityFunctions(moving, len(energy), options, ends)


def parametric_functions(
    energy: CasadiEnergy, options: CostOptions, num_regrasps: int, *, blocking: bool = False
) -> ConnectivityFunctions:
    """Return the functions of ``xi`` (N, 3), ``layers`` (H, (3 G + 2) N), ``start`` and ``goal`` (G, 1).

    They are differentiable in ``xi`` only; `layers_parameter` makes ``layers``. With `blocking`, ``blocked`` (G, N)
    follows ``layers``: 1 for grasps known to be infeasible at a pose, 0 for others.
    """
    xi, packed = ca.MX.sym("xi", 3, num_regrasps), _layers_symbol(energy, num_regrasps)
    inputs = {"xi": xi, "layers": packed}
    if blocking:
        inputs["blocked"] = ca.MX.sym("blocked", energy.count, num_regrasps)

    def make(ids: IntArray, tangents: bool) -> list[PoseEnergy]:
        layers = _split(energy, packed)
        poses = [planar_energy(energy, layer, xi[:, i], tangents=tangents) for i, layer in enumerate(layers)]
        if not blocking:
            return poses
        return [blocks.PartlyKnownEnergy(pose, inputs["blocked"][:, i], BLOCKED) for i, pose in enumerate(poses)]

    return ConnectivityFunctions(_planar(inputs, make), energy.count, options, ChainEnds(INPUT, INPUT), free_ends=False)


def _planar(inputs: Mapping[str, Any], make: Callable[[IntArray, bool], list[PoseEnergy]]) -> _Moving:
    return _Moving(inputs, "xi", make, inputs["xi"].shape[::-1], lambda xi: xi.T)


def plain_sequence_cost(energy: CasadiEnergy, options: CostOptions, num_regrasps: int) -> Any:
    """Return ``J_seq`` of `parametric_functions` built without derivatives of its own: the reference for them."""
    xi, packed = ca.MX.sym("xi", num_regrasps, 3), _layers_symbol(energy, num_regrasps)
    ends = [ca.MX.sym(name, energy.count) for name in ("start", "goal")]
    energies = [energy.planar_expression(layer, xi[i, :].T) for i, layer in enumerate(_split(energy, packed))]
    chain = [ends[0], *energies, ends[1]]
    scores = [pair_score(a, b, options) for a, b in itertools.pairwise(chain)]
    cost = cost_of_scores(scores, options.regularisation)
    return ca.Function("J_seq_plain", [xi, packed, *ends], [cost], ["xi", "layers", "start", "goal"], ["J"])


def layers_parameter(energy: GraspEnergy, placements: PlanarPoses, grasp_ids: Any = slice(None)) -> FloatArray:
    """Return the ``layers`` input (H, (3 G + 2) N) of the chosen grasps at N `placements`."""
    layers = [np.concatenate(layer, axis=1) for layer in energy.planar_layers(placements, grasp_ids)]
    return np.concatenate(layers, axis=1) if layers else np.zeros((energy.model.hidden, 0))


def _layers_symbol(energy: CasadiEnergy, num_regrasps: int) -> Any:
    return ca.MX.sym("layers", energy.model.hidden, (3 * energy.count + 2) * num_regrasps)


def _split(energy: CasadiEnergy, layers: Any) -> list[PlanarLayer]:
    return [energy.layer_parameter(part) for part in ca.horzsplit(layers, 3 * energy.count + 2)]
