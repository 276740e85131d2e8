"""Time-optimal motion from one rest to the next as one nonlinear program in CasADi.

A run leaves along a straight line of the tool, crosses to where another line begins, and ends along that one, without
a stop on its way. On the lines the path is given and its speed ``y = ds/dt`` is free; between them the motion is free,
transcribed directly: the positions ``q_k`` and velocities ``v_k`` of M knots joined by cubics, each of which takes
``h``. With unit limits for speeds and accelerations,

    minimise    time(y) + M h + weight * mean squared acceleration
    subject to  |q''(s) y^2 + q'(s) (y^2)' / 2| <= 1,  |q'(s) y| <= 1        on both lines
                accelerations at both ends of each cubic, speeds at its ends and in its middle
                v_0 = q'(s) y, v_M = q'(s) y                                 where line and crossing meet
                lower <= q_k <= upper

Accelerations of a cubic are linear in time, so the limits hold all over it; its speed may exceed the limit by the
little that `Trajectory.within` takes back. Collisions are not considered here: bounds on ``q_k`` keep it near a given
path, and the result is verified afterwards.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.solvers.nonlinear_program import NonlinearProgram
from regrasp_opt.solvers.options import ProgramOptions

LINE_STEPS = 12
"""Intervals of each line."""

STEPS = 14
"""Cubics of the crossing."""

SMOOTHNESS = 0.02
"""Weight of the mean squared acceleration, in shares of its limit, beside seconds."""

SLOWEST = 1e-3
"""Least speed along a line away from its rest [1/s]."""

SHORTEST = 1e-3
"""Least time of a cubic [s]."""

FEASIBLE = 1e-3
"""Violation of a limit, as a share of it, that slowing down takes back."""

OPTIONS = ProgramOptions(max_iterations=80, tolerance=1e-3, ipopt=(("mu_init", 1e-2),))


class Line(NamedTuple):
    """A line of the tool over s in [0, 1], `LINE_STEPS` + 1 points: positions and derivatives (points, dof)."""

    positions: FloatArray
    first: FloatArray
    second: FloatArray


class Crossing(NamedTuple):
    """Where the knots of a crossing begin their search (`STEPS` + 1, dof), and between which positions they stay."""

    guess: FloatArray
    lower: FloatArray
    upper: FloatArray


def fastest_run(
    before: Line | None, crossing: Crossing, after: Line | None, velocity: FloatArray, acceleration: FloatArray
) -> list[Trajectory] | None:
    """Return the parts of the fastest run from rest to rest within limits (dof,), or None where Ipopt fails.

    Each part ends with the velocity with which the next begins. Without `before` or `after` the crossing begins or
    ends at rest.
    """
    program = _program(len(velocity), before is not None, after is not None)
    return program.solve(before, crossing, after, velocity, acceleration)


@lru_cache(maxsize=16)
def _program(dof: int, before: bool, after: bool) -> _RunProgram:
    return _RunProgram(dof, before, after)


class _RunProgram:
    def __init__(self, dof: int, before: bool, after: bool) -> None:
        nlp, time = NonlinearProgram(ca.SX), ca.SX(0)

        def limit(name: str, share: Any) -> None:
            nlp.add_constraint(name, share, lower=-1.0, upper=1.0)

        velocity, acceleration = nlp.parameter("velocity", dof), nlp.parameter("acceleration", dof)
        v_ends = [ca.SX(dof, 1), ca.SX(dof, 1)]
        for end, (name, present) in enumerate((("before", before), ("after", after))):
            if not present:
                continue
            y = nlp.variable(f"speed {name}", LINE_STEPS, lower=SLOWEST)  # all but the rest
            first, second = (nlp.parameter(f"{each} {name}", (dof, LINE_STEPS + 1)) for each in ("first", "second"))
            speeds = ca.vertcat(0, y) if end == 0 else ca.vertcat(y, 0)
            time += ca.sum1(2 / LINE_STEPS / (speeds[1:] + speeds[:-1]))
            gain = (speeds[1:] ** 2 - speeds[:-1] ** 2) * LINE_STEPS / 2
            accelerations = [
                (first[:, i] * gain[k] + second[:, i] * speeds[i] ** 2) / acceleration
                for k in range(LINE_STEPS)
                for i in (k, k + 1)
            ]
            limit(f"acceleration {name}", ca.vertcat(*accelerations))
            moving = range(1 - end, LINE_STEPS + 1 - end)
            limit(f"velocity {name}", ca.vertcat(*[first[:, i] * speeds[i] / velocity for i in moving]))
            v_ends[end] = first[:, -1] * y[-1] if end == 0 else first[:, 0] * y[0]
        Q, V = nlp.variable("q", (STEPS - 1, dof)), nlp.variable("v", (STEPS - 1, dof))
        h = nlp.variable("h", lower=SHORTEST)
        q_ends = nlp.parameter("ends", (dof, 2))
        q = ca.horzcat(q_ends[:, 0], Q.T, q_ends[:, 1])
        v = ca.horzcat(v_ends[0], V.T, v_ends[1])
        step, v_first, v_last = (q[:, 1:] - q[:, :-1]) / h, v[:, :-1], v[:, 1:]
        spread = ca.repmat(acceleration * h, 1, STEPS)
        a_first, a_last = (6 * step - 4 * v_first - 2 * v_last) / spread, (2 * v_first + 4 * v_last - 6 * step) / spread
        middle = 1.5 * step - (v_first + v_last) / 4
        for name, share in (("first acceleration", a_first), ("last acceleration", a_last)):
            limit(name, ca.vec(share))
        for name, each in (("velocity", V.T), ("velocity between", middle)):
            limit(name, ca.vec(each / ca.repmat(velocity, 1, each.shape[1])))
        effort = ca.sumsqr(a_first) + ca.sumsqr(a_last)
        nlp.add_cost(time + STEPS * h + SMOOTHNESS / (2 * STEPS * dof) * effort)
        self._solver = nlp.solver(OPTIONS)

    def solve(
        self,
        before: Line | None,
        crossing: Crossing,
        after: Line | None,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> list[Trajectory] | None:
        lines = [(line, end) for end, line in enumerate((before, after)) if line is not None]
        speeds = [_speeds(line, velocity, acceleration, end) for line, end in lines]
        q = crossing.guess
        h = 1.5 * float((np.abs(np.diff(q, axis=0)) / velocity).max()) + SHORTEST
        v = (q[2:] - q[:-2]) / (2 * h)
        x0 = np.concatenate([*speeds, q[1:-1].ravel(), v.ravel(), [h]])
        slow, free = np.full(LINE_STEPS * len(lines), SLOWEST), np.full(v.size, np.inf)
        low = np.concatenate([slow, crossing.lower[1:-1].ravel(), -free, [SHORTEST]])
        high = np.concatenate([np.full(slow.size, np.inf), crossing.upper[1:-1].ravel(), free, [np.inf]])
        p = np.concatenate(
            [velocity, acceleration, *(part.ravel() for line, _ in lines for part in line[1:]), q[0], q[-1]]
        )
        solution = self._solver.solve(x0, p=p, lbx=low, ubx=high)
        return self._parts(solution.x, lines, q) if solution.violation <= FEASIBLE else None

    @staticmethod
    def _parts(x: FloatArray, lines: list[tuple[Line, int]], guess: FloatArray) -> list[Trajectory]:
        dof, h = guess.shape[1], float(x[-1])
        Q, V = x[LINE_STEPS * len(lines) : -1].reshape(2, STEPS - 1, dof)
        ends, found = [np.zeros(dof), np.zeros(dof)], dict[int, Trajectory]()
        for number, (line, end) in enumerate(lines):
            y = x[LINE_STEPS * number : LINE_STEPS * (number + 1)]
            speeds = np.append(0.0, y) if end == 0 else np.append(y, 0.0)
            times = np.concatenate([[0.0], np.cumsum(2 / LINE_STEPS / (speeds[1:] + speeds[:-1]))])
            found[2 * end] = Trajectory(times, line.positions, line.first * speeds[:, None])
            ends[end] = found[2 * end].velocities[-1 if end == 0 else 0]
        positions = np.vstack([guess[:1], Q, guess[-1:]])
        times = np.linspace(0.0, STEPS * h, STEPS + 1)
        found[1] = Trajectory(times, positions, np.vstack([ends[0], V, ends[1]]))
        return [found[k] for k in sorted(found)]


def _speeds(line: Line, velocity: FloatArray, acceleration: FloatArray, end: int) -> FloatArray:
    """Return a slow start for the speeds (`LINE_STEPS`,) along `line`, which rests at its other `end`."""
    first = np.maximum(np.abs(line.first).max(axis=0), 1e-9)
    top = 0.5 * min(float((velocity / first).min()), float(np.sqrt((acceleration / first).min())))
    rising = top * np.sqrt(np.arange(1, LINE_STEPS + 1) / LINE_STEPS)
    return rising if end == 0 else rising[::-1]
