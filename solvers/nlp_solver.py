"""A CasADi solver of one program, and what it says about a solution.

Neither a CasADi solver nor MUMPS may be used from two threads at once; a lock prevents it.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.solvers.options import ProgramOptions, plugin_options

CONVERGED = {"Solve_Succeeded", "Solved_To_Acceptable_Level"}
lock = threading.RLock()


@dataclass(frozen=True, eq=False)
class NlpSolution:
    """Where a solver ended.

    Attributes
    ----------
    x : (n,)
    f : float
        The objective there.
    g : (r,)
        The constraints there.
    status : str
        How the solver ended, in its own words.
    converged : bool
        Whether it says that it converged.
    violation : float
        By how much a constraint or bound fails at most, recomputed from ``x`` and ``g``.
    iterations : int
    evaluations : int
        Calls of the objective, the constraints and their derivatives.
    trace : (k,)
        The objective by iteration, the start first; empty where the plugin does not tell.
    path : (k, n)
        ``x`` by iteration, the start first; empty unless `ProgramOptions.record` is set.
    """

    x: FloatArray
    f: float
    g: FloatArray
    status: str
    converged: bool
    violation: float
    iterations: int
    evaluations: int
    trace: FloatArray
    path: FloatArray


class NlpSolver:
    """A CasADi solver for the program ``{x, p, f, g}``.

    Raises
    ------
    OptionError
        If the plugin cannot be set up.
    """

    def __init__(
        self,
        program: Mapping[str, Any],
        settings: ProgramOptions,
        rows: tuple[ArrayLike, ArrayLike] = (-np.inf, np.inf),
    ) -> None:
        self.settings = settings
        self._rows = rows
        self._recorder = _Recorder(program) if settings.record else None
        options = {"print_time": False, **plugin_options(settings)}
        if self._recorder is not None:
            options["iteration_callback"] = self._recorder
        try:
            self.casadi_solver: Any = ca.nlpsol("regrasp", settings.plugin, dict(program), options)
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1]
            raise OptionError(
                f"CasADi cannot set up the plugin '{settings.plugin}' ({reason}); check its options"
            ) from error

    def solve(
        self,
        x0: ArrayLike,
        *,
        lbx: ArrayLike = -np.inf,
        ubx: ArrayLike = np.inf,
        lbg: ArrayLike | None = None,
        ubg: ArrayLike | None = None,
        p: ArrayLike = (),
    ) -> NlpSolution:
        """Return what is found from `x0` (n,) with parameters `p` (m,).

        The bounds `lbx`, `ubx` of the variables and `lbg`, `ubg` of the constraints are as `casadi.nlpsol` takes them;
        those of the constraints are the program's own where they are not given.
        """
        lbg, ubg = (own if given is None else given for own, given in zip(self._rows, (lbg, ubg), strict=True))
        with lock:
            if self._recorder is not None:
                self._recorder.points.clear()
            found = self.casadi_solver(x0=x0, p=np.asarray(p), lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
            stats = self.casadi_solver.stats()
            points = [] if self._recorder is None else self._recorder.points.copy()
        x, g, f = np.array(found["x"]).ravel(), np.array(found["g"]).ravel(), float(found["f"])
        beyond = [np.asarray(lbx) - x, x - np.asarray(ubx), np.asarray(lbg) - g, g - np.asarray(ubg)]
        violation = max([0.0, *(float(part.max()) for part in beyond if part.size)])
        status = str(stats.get("return_status", "unknown"))
        return NlpSolution(
            x,
            f,
            g,
            status,
            status in CONVERGED or (self.settings.plugin != "ipopt" and bool(stats.get("success", False))),
            violation if np.isfinite(x).all() and np.isfinite(g).all() else np.inf,
            int(stats.get("iter_count", 0)),
            sum(int(count) for name, count in stats.items() if name.startswith("n_call_nlp_")),
            np.array(stats.get("iterations", {}).get("obj", []), dtype=np.float64),
            np.array(points, dtype=np.float64).reshape(-1, len(x)),
        )


class _Recorder(ca.Callback):
    """What a CasADi solver calls after each iteration: it keeps ``x``."""

    def __init__(self, program: Mapping[str, Any]) -> None:
        ca.Callback.__init__(self)
        self.points: list[FloatArray] = []
        sizes = {name: program[name].shape if name in program else (0, 1) for name in ("x", "f", "g", "p")}
        sizes |= {f"lam_{name}": sizes[name] for name in ("x", "g", "p")}
        self._shapes = [sizes[name] for name in ca.nlpsol_out()]
        self.construct("recorder", {})

    def get_n_in(self) -> int:
        return len(self._shapes)

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, number: int) -> Any:
        return ca.Sparsity.dense(*self._shapes[number])

    def eval(self, arguments: Any) -> list[float]:
        self.points.append(np.array(arguments[0]).ravel())
        return [0.0]
