"""Timings of what plans are made of: derivatives of ``J_seq``, Ipopt's cost by size, exact checks.

Everything is a ratio or a median within one process; energies here are random, because values do not change timings.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import casadi as ca
import joblib
import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_opt.benchmarks.harness.runner import Row
from regrasp_opt.benchmarks.harness.subjects import resident
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.casadi_costs import layers_parameter, parametric_functions, plain_sequence_cost
from regrasp_opt.conventions import BoolArray, FloatArray, planar_transform
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.energy.features import feature_count
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.feasibility.dataset import random_poses
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.grasps import GraspSet
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.threads import one_blas_thread

SIZES = {"N": (1, 2, 3, 4, 6, 8), "G": (50, 100, 200, 500, 1000, 2000), "H": (32, 64, 128, 256)}
STANDARD = {"N": 2, "G": 200, "H": 64}
DERIVATIVE_SIZES = {"N": 3, "G": 200, "H": 128}
"""Regrasps, grasps and hidden width at which derivatives are compared."""
PROCESSES = 2
"""Number of processes in which exact checks are timed."""


def random_energy(count: int, hidden: int, seed: int = 0) -> GraspEnergy:
    """Return an energy with random weights on `count` random grasps."""
    rng = np.random.default_rng(seed)
    shapes = [(hidden, feature_count("tcp", True)), (hidden, hidden), (1, hidden)]
    weights = tuple((1.5 * rng.normal(size=s) / np.sqrt(s[1])).astype(np.float32) for s in shapes)
    biases = tuple((0.3 * rng.normal(size=s[0])).astype(np.float32) for s in shapes)
    model = EnergyModel(weights, biases, "silu", "tcp", True, True, 1.0)
    return GraspEnergy(model, GraspSet(_transforms(rng, count), rng.uniform(0.01, 0.1, count), "parallel"))


def _transforms(rng: np.random.Generator, count: int) -> FloatArray:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = 0.1 * rng.normal(size=(count, 3))
    return T


def median_time(function: Callable[[], Any], repeats: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the median time of `function` over `repeats` calls after one that is not counted [s]."""
    function()
    times = []
    for _ in range(repeats):
        began = clock()
        function()
        times.append(clock() - began)
    return float(np.median(times))


def _arguments(energy: GraspEnergy, num_regrasps: int) -> tuple[Any, ...]:
    rng = np.random.default_rng(1)
    layers = layers_parameter(energy, PlanarPoses.level(_transforms(rng, num_regrasps), np.zeros((2, 2))))
    ends = rng.uniform(0, 4, (2, len(energy)))
    return ca.DM(rng.normal(size=(num_regrasps, 3))), ca.DM(layers), *map(ca.DM, ends)


def _derivatives(cost: Any) -> tuple[Any, Any]:
    """Return gradient and Hessian of the function `cost` in its first input as functions of all its inputs."""
    x, *parameters = inputs = [ca.MX.sym(cost.name_in(i), *cost.size_in(i)) for i in range(cost.n_in())]
    hessian, gradient = ca.hessian(cost(x, *parameters), ca.vec(x))
    return ca.Function("gradient", inputs, [gradient]), ca.Function("hessian", inputs, [hessian])


class _ProductsByBlas(CasadiEnergy):
    """Expressions whose products with weights have derivatives through BLAS too.

    CasADi's differentiation multiplies in its own loops, whichever product it differentiates. Here it meets calls of
    functions that bring their derivatives along: `directions` forward ones at once, and the adjoint.
    """

    def __init__(self, model: EnergyModel, count: int, directions: int) -> None:
        super().__init__(model, count)
        self._directions = directions

    def product(self, a: Any, b: Any) -> Any:
        if not (a.is_constant() and a.shape[1] > 1):
            return super().product(a, b)
        return self._linear("product", a.to_DM(), adjoint=True)(b)

    def _linear(self, name: str, W: Any, *, adjoint: bool) -> Any:
        shape = W.shape[1], self.count
        x, none = ca.MX.sym("x", *shape), ca.MX.sym("none", ca.Sparsity(W.shape[0], self.count))
        seeds = ca.MX.sym("seeds", shape[0], self._directions * self.count)
        forward, back = f"fwd{self._directions}_{name}", f"adj1_{name}"
        pushed = [super().product(ca.MX(W), seeds)]
        rules = {forward: ca.Function(forward, [x, none, seeds], pushed, ["x", "out_y", "fwd_x"], ["fwd_y"])}
        if adjoint:
            seed = ca.MX.sym("seed", W.shape[0], self.count)
            pulled = [self._linear(f"transposed_{name}", W.T, adjoint=False)(seed)]
            rules[back] = ca.Function(back, [x, none, seed], pulled, ["x", "out_y", "adj_y"], ["adj_x"])
        return ca.Function(name, [x], [super().product(ca.MX(W), x)], ["x"], ["y"], {"cache": rules})


def derivative_rows(repeats: int) -> list[Row]:
    """Return processor times [s] of our derivatives and of CasADi's of the plainly built cost, and their disagreement.

    CasADi multiplies by the same BLAS: in the cost (``plain``), or in its derivatives too (``blas``). They are timed
    in turn, with one BLAS thread, so that their ratios hold on a busy machine.
    """
    num_regrasps, count, hidden = (DERIVATIVE_SIZES[axis] for axis in "NGH")
    energy = random_energy(count, hidden)
    arguments = _arguments(energy, num_regrasps)
    plain = CasadiEnergy(energy.model, count)
    built = {"plain": plain, "blas": _ProductsByBlas(energy.model, count, 3 * num_regrasps)}
    costs = {"ours": parametric_functions(plain, CostOptions(), num_regrasps).J_seq}
    costs |= {key: plain_sequence_cost(energies, CostOptions(), num_regrasps) for key, energies in built.items()}
    functions = {key: _derivatives(cost) for key, cost in costs.items()}
    rows: list[Row] = []
    with one_blas_thread():
        for number, kind in enumerate(("gradient", "hessian")):
            calls = {key: partial(both[number], *arguments) for key, both in functions.items()}
            ours, *others = (call() for call in calls.values())
            difference = max(float(ca.norm_inf(ca.vec(ours - other))) for other in others)
            turns = [[median_time(call, 1, time.thread_time) for call in calls.values()] for _ in range(repeats)]
            times = dict(zip(calls, np.median(turns, axis=0).tolist(), strict=True))
            rows.append({"derivative": kind, **DERIVATIVE_SIZES, **times, "difference": difference})
    return rows


def iteration_rows(axis: str, repeats: int) -> list[Row]:
    """Return the time [s] of what one Ipopt iteration evaluates (cost, gradient, Hessian) along `axis` "N", "G" or "H".

    Sizes are timed in turn, and a size's time is the median of its turns: what else the machine does meets them alike.
    """
    rows, calls = [], []
    for size in SIZES[axis]:
        at = {**STANDARD, axis: size}
        energy = random_energy(at["G"], at["H"])
        cost = parametric_functions(CasadiEnergy(energy.model, at["G"]), CostOptions(), at["N"]).J_seq
        arguments = _arguments(energy, at["N"])
        calls.append([partial(call, *arguments) for call in (cost, *_derivatives(cost))])
        rows.append(at)
    turns = [[sum(median_time(call, 1) for call in size) for size in calls] for _ in range(repeats)]
    medians = np.median(turns, axis=0).tolist()
    return [{"along": axis, **at, "iteration": seconds} for at, seconds in zip(rows, medians, strict=True)]


def exponent(rows: Sequence[Row], axis: str) -> float:
    """Return the slope of log time over log size by least squares."""
    sizes, seconds = (np.log([row[key] for row in rows]) for key in (axis, "iteration"))
    return float(np.polyfit(sizes, seconds, 1)[0])


def check_rows(pairs: int) -> list[Row]:
    """Return exact checks a second of `PROCESSES` processes, those of a plain loop, and how many labels differ."""
    problem = RegraspProblem.load("bottle", "nova2-w")
    count = len(problem.grasps)
    poses = -(-pairs // count)
    numbers, xi = random_poses(problem.placement_poses, problem.workcell.bounds.array, poses, np.random.default_rng(0))
    parts = np.array_split(planar_transform(xi) @ problem.placement_poses[numbers], 4 * PROCESSES)
    labels, rates = [], []
    with joblib.Parallel(n_jobs=PROCESSES) as parallel:
        list(parallel(joblib.delayed(_batched)(problem, part[:1]) for part in parts))  # start the workers
        for check in (_batched, _plain_loop):
            began = time.perf_counter()
            labels.append(np.concatenate(list(parallel(joblib.delayed(check)(problem, part) for part in parts))))
            rates.append(labels[-1].size / (time.perf_counter() - began))
    return [
        {
            "processes": PROCESSES,
            "pairs": labels[0].size,
            "per_second": rates[0],
            "plain_per_second": rates[1],
            "different_labels": int((labels[0] != labels[1]).sum()),
            "feasible_share": float(labels[0].mean()),
        }
    ]


def _batched(problem: RegraspProblem, T: FloatArray) -> BoolArray:
    checker = resident(problem).checker
    return np.array([checker.feasible(pose) for pose in T]).reshape(len(T), len(checker.grasps))


def _plain_loop(problem: RegraspProblem, T: FloatArray) -> BoolArray:
    """Check pair by pair as one would at first: inverse kinematics, then its branches until one is free."""
    checker = resident(problem).checker
    cell, scene, grasps = checker.workcell, checker.scene, checker.grasps
    labels = np.zeros((len(T), len(grasps)), dtype=bool)
    for b, pose in enumerate(T):
        scene.place_object(pose)
        if checker.object_collides(pose):
            continue
        for g in range(len(grasps)):
            scene.set_grasp(g)
            T_world_flange = pose @ grasps.T_object_tcp[g] @ cell.arm.end_effector.T_tcp_flange
            branches = cell.arm.robot.solve_ik(cell.arm.T_base_world @ T_world_flange).q
            labels[b, g] = any(not scene.collides(q) for q in branches)
    return labels
