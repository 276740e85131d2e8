"""Newton's method on the pose error of many configurations at once: damped, batched, deterministic.

Levenberg-Marquardt (Nocedal and Wright, Numerical Optimization, section 10.3) on the twist from the tip to its
target. It polishes what an analytic solver finds for a slightly different arm, and searches from many starts
where there is no analytic solver. As in `SerialChain`, the batch is the last axis inside, so that every
operation runs over contiguous memory; batches are cut into pieces that stay in the cache.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.robots.kinematics import SerialChain

CHUNK = 1024
"""Configurations in one piece."""
CONVERGED = 1e-9
"""Error below which a configuration is left where it is [m, rad]."""
NEAR = 2e-4
"""Error from which two steps with one Jacobian mostly suffice [m, rad]."""
LARGEST_STEP = 0.5
"""How far a joint moves in one step [rad, m]."""
LEAST_DAMPING = 1e-11
"""Added to the diagonal of J^T J, besides what is proportional to the squared error."""

Limits = tuple[FloatArray, FloatArray]


def polish(chain: SerialChain, T: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return `q` (B, dof) after two steps towards `T` (B, 4, 4), and the errors (B,) left [m, rad].

    A Newton step in single precision, then one in double precision that reuses its factors if the first one came near.
    """
    moved, errors = np.empty_like(q), np.empty(len(q))
    for part in _pieces(len(q)):
        goal, x = _goal(T[part]), np.array(q[part].T, order="C")
        error, J = _error(chain, goal.astype(np.float32), x.astype(np.float32))
        damping, far = np.full(x.shape[1], LEAST_DAMPING), bool(np.median(np.abs(error).max(0)) > NEAR)
        factors = _factors(J.astype(np.float64), damping)
        x = x + _capped(_solve(factors, _gradient(J, error)))
        error, new_J = _error(chain, goal, x, jacobian=far)
        if far:
            J, factors = new_J, _factors(new_J, damping)
        x = x + _capped(_solve(factors, _gradient(J, error)))
        error = _error(chain, goal, x, jacobian=False)[0]
        moved[part], errors[part] = x.T, np.sqrt((error**2).sum(0))
    return moved, errors


def descend(
    chain: SerialChain, T: FloatArray, q: FloatArray, steps: int, limits: Limits | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return `q` (B, dof) after at most `steps` damped steps towards `T` (B, 4, 4), and the errors (B,) left.

    With `limits`, two arrays (dof,), no joint leaves them; `q` starts within.
    """
    moved, errors = np.empty_like(q), np.empty(len(q))
    for part in _pieces(len(q)):
        x, errors[part] = _descend(chain, _goal(T[part]), np.array(q[part].T, order="C"), steps, limits)
        moved[part] = x.T
    return moved, errors


def astride(chain: SerialChain, q: FloatArray, step: float) -> FloatArray:
    """Return configurations (2 B, dof) to either side of all `q` (B, dof), `step` [rad, m] away from them.

    The direction is the one in which the tip moves least. Where two branches meet, one lies on either side.
    """
    x = np.array(q.T, order="C")
    J = _error(chain, _goal(np.eye(4)[None].repeat(len(q), 0)), x)[1]
    factors, direction = _factors(J, np.full(len(q), LEAST_DAMPING)), np.ones_like(x)
    if chain.still is not None:
        direction[chain.still] = 0.0
    for _ in range(3):  # inverse iteration
        direction = _solve(factors, direction)
        direction = direction / np.abs(direction).max(axis=0)
    return np.concatenate([q + step * direction.T, q - step * direction.T])


def _descend(
    chain: SerialChain, goal: FloatArray, q: FloatArray, steps: int, limits: Limits | None
) -> tuple[FloatArray, FloatArray]:
    """Do the steps of `descend` for one piece, `q` (dof, B) and `goal` same as in `_goal`."""
    moved, errors, live = q.copy(), np.full(q.shape[1], np.inf), np.arange(q.shape[1])
    damping = np.ones(q.shape[1])
    error, J = _error(chain, goal, q)
    size = np.sqrt((error**2).sum(0))
    for step in range(steps + 1):
        moved[:, live], errors[live] = q, size
        going = size > CONVERGED
        if step == steps or not going.any():
            break
        if not going.all():
            live, goal, q, damping = live[going], goal[..., going], q[:, going], damping[going]
            error, J, size = error[:, going], J[..., going], size[going]
        gradient, free = _gradient(J, error), J
        if limits is not None:  # a joint that is at its limit and would leave stays
            low, high = limits[0][:, None], limits[1][:, None]
            may_move = ~(((q <= low) & (gradient < 0)) | ((q >= high) & (gradient > 0)))
            gradient, free = gradient * may_move, J * may_move
        trial = q + _capped(_solve(_factors(free, damping * size**2 + LEAST_DAMPING), gradient))
        if limits is not None:
            trial = np.clip(trial, low, high)
        new_error, new_J = _error(chain, goal, trial)
        new_size = np.sqrt((new_error**2).sum(0))
        better = new_size < size
        for old, new in ((q, trial), (error, new_error), (J, new_J), (size, new_size)):
            np.copyto(old, new, where=better)
        damping = np.where(better, damping / 4, damping * 8)
    return moved, errors


def _pieces(count: int) -> list[slice]:
    return [slice(start, start + CHUNK) for start in range(0, count, CHUNK)]


def _goal(T: FloatArray) -> FloatArray:
    """Return the axes and the origin of poses (B, 4, 4), as (4, 3, B)."""
    return np.ascontiguousarray(T[:, :3].transpose(2, 1, 0))


def _error(chain: SerialChain, goal: FloatArray, q: FloatArray, jacobian: bool = True) -> tuple[FloatArray, FloatArray]:
    """Return the twist (6, B) from the tip at `q` (dof, B) to `goal`, linear part first, and the Jacobian.

    The Jacobian (6, dof, B) is that of the tip's velocity in the base frame, empty unless asked for.
    A joint that the chain has still has a column of zeros, so that no step moves it.
    """
    axes, origins = chain.frames(q.T, q.dtype.type)
    tip, origin = axes[-1], origins[-1]
    turn = (_cross(tip[0], goal[0]) + _cross(tip[1], goal[1]) + _cross(tip[2], goal[2])) / 2
    sine = np.sqrt((turn**2).sum(0))
    angle = np.arctan2(sine, ((tip * goal[:3]).sum((0, 1)) - 1) / 2)
    turn = turn * (np.where(sine > 1e-9, angle, 1.0) / np.where(sine > 1e-9, sine, 1.0))
    error = np.concatenate([goal[3] - origin, turn])
    if not jacobian:
        return error, error[:0]
    z = np.stack([axis[2] for axis in axes[:-1]], axis=1)
    linear = _cross(z, origin[:, None] - np.stack(origins[:-1], axis=1))
    slides = chain.prismatic[:, None]
    J = np.concatenate([np.where(slides, z, linear), np.where(slides, 0.0, z)] if slides.any() else [linear, z])
    if chain.still is not None:
        J[:, chain.still] = 0.0
    return error, J


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _gradient(J: FloatArray, error: FloatArray) -> FloatArray:
    """Return J^T error, (dof, B)."""
    product: FloatArray = np.einsum("kib,kb->ib", J, error)
    return product


def _factors(J: FloatArray, damping: FloatArray) -> FloatArray:
    """Return the LU factors of ``J^T J + damping I``, without pivots: it is positive definite."""
    A: FloatArray = np.einsum("kib,kjb->ijb", J, J)
    diagonal = np.arange(len(A))
    A[diagonal, diagonal] += damping
    for k in range(len(A) - 1):
        A[k + 1 :, k] /= A[k, k]
        A[k + 1 :, k + 1 :] -= A[k + 1 :, k, None] * A[k, k + 1 :]
    return A


def _solve(factors: FloatArray, b: FloatArray) -> FloatArray:
    """Return x (dof, B) with ``L U x = b``."""
    x = b.copy()
    for k in range(len(x) - 1):
        x[k + 1 :] -= factors[k + 1 :, k] * x[k]
    for k in reversed(range(len(x))):
        x[k] /= factors[k, k]
        x[:k] -= factors[:k, k] * x[k]
    return x


def _capped(step: FloatArray) -> FloatArray:
    """Return the step (dof, B), shortened so that no joint moves further than `LARGEST_STEP`."""
    return step * np.minimum(1.0, LARGEST_STEP / np.maximum(np.abs(step).max(axis=0), LARGEST_STEP))
