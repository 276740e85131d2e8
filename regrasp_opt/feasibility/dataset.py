"""Labelled (pose, grasp) pairs: what the energy is trained on and calibrated with.

Poses are random stable placements at uniform planar parameters in the workspace. Training pairs are drawn in seeded
blocks until enough are feasible; every finished block is on disk, so an interrupted run resumes where it stopped.
Validation poses are labelled for every grasp, because calibration needs to know which grasps two poses share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, planar_transform
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.feasibility.checker import FeasibilityChecker
from regrasp_opt.feasibility.diagnosis import diagnose_poses, summary
from regrasp_opt.files import UNREADABLE_ARRAYS, atomic_path, content_hash, machine_memory
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel
from regrasp_opt.scene import Workcell
from regrasp_opt.workers import workers

POSES_PER_BLOCK = 200
GRASPS_PER_POSE = 25
_HOPELESS_BLOCKS = 20
"""Blocks without one feasible pair after which sampling gives up."""
BYTES_PER_PAIR = 2500
"""Memory that a pair takes until both energies are trained: its pose, its features, and copies of both."""
_ENOUGH_TO_TELL = 200
"""Feasible pairs that say well enough how many pairs will have to be drawn."""


@dataclass(frozen=True)
class LabelledPairs:
    """M labelled pairs.

    Attributes
    ----------
    T : (M, 4, 4)
        Object poses T_world_object.
    grasp_ids : (M,)
    feasible : (M,) bool
    """

    T: FloatArray
    grasp_ids: IntArray
    feasible: BoolArray

    def __len__(self) -> int:
        return len(self.feasible)


@dataclass(frozen=True)
class LabelledPoses:
    """Poses `T` (B, 4, 4) with the feasibility (B, G) of every grasp."""

    T: FloatArray
    feasible: BoolArray


@dataclass(frozen=True)
class LabellingTask:
    """Everything that labels depend on; small enough to be sent to worker processes."""

    model: ObjectModel
    workcell: Workcell
    grasps: GraspSet
    placements: FloatArray
    seed: int

    def fingerprint(self) -> str:
        """Return the hash under which labels are stored."""
        parts = [
            self.model.fingerprint(),
            self.workcell.fingerprint(),
            self.grasps.fingerprint(),
            self.placements,
        ]
        return content_hash("labels-3", *parts, self.seed, POSES_PER_BLOCK, GRASPS_PER_POSE)


def random_poses(
    placements: FloatArray, bounds: FloatArray, count: int, rng: np.random.Generator
) -> tuple[IntArray, FloatArray]:
    """Return placement numbers (count,) and planar parameters (count, 3), uniform over `bounds` (2, 2) and a turn."""
    return PlanarPoses.level(placements, bounds).draw(count, rng)


def label_pairs(
    task: LabellingTask,
    feasible_wanted: int,
    *,
    folder: Path,
    jobs: int = -1,
    progress: Callable[[int, int], None] | None = None,
) -> LabelledPairs:
    """Label pairs, block by block, until `feasible_wanted` of them are feasible.

    Parameters
    ----------
    folder : Path
        Where blocks are kept. Blocks of the same task found there are used; others and broken ones are not.
    jobs : int
        Worker processes, as joblib counts them.
    progress : callable, optional
        Called with (feasible pairs so far, feasible pairs wanted).

    Raises
    ------
    GraspError
        If no grasp is feasible anywhere in the workspace.
    OptionError
        If the pairs would not fit into the memory of this machine.
    """
    _check_memory(feasible_wanted, feasible_wanted)
    name = task.fingerprint()[:16]
    blocks: list[LabelledPairs] = []
    found = 0
    at_once = joblib.effective_n_jobs(jobs)
    with workers(jobs, "generator") as parallel:
        while found < feasible_wanted:
            missing = (feasible_wanted - found) / max(found / max(len(blocks), 1), 1.0) if blocks else at_once
            numbers = range(len(blocks), len(blocks) + int(np.clip(missing + 1, 1, 16 * at_once)))
            for block in parallel(joblib.delayed(_block)(task, b, folder / f"{name}-{b:05d}.npz") for b in numbers):
                blocks.append(block)
                found += int(block.feasible.sum())
                if progress is not None:
                    progress(min(found, feasible_wanted), feasible_wanted)
            if found >= _ENOUGH_TO_TELL:
                _check_memory(feasible_wanted, feasible_wanted * sum(map(len, blocks)) / found)
            if len(blocks) >= _HOPELESS_BLOCKS and not any(b.feasible.any() for b in blocks[:_HOPELESS_BLOCKS]):
                failures = diagnose_poses(_checker(task), blocks[0].T[::GRASPS_PER_POSE], np.random.default_rng(0))
                raise GraspError(
                    f"no grasp of '{task.workcell.arm.end_effector.name}' on '{task.model.name}' is feasible anywhere "
                    f"in the workspace; of {len(failures)} tried {summary(failures)}"
                )
    enough = int(np.searchsorted(np.cumsum([b.feasible.sum() for b in blocks]), feasible_wanted)) + 1
    blocks = blocks[:enough]  # how many were begun depends on the number of workers; how many count does not
    return LabelledPairs(
        np.concatenate([b.T for b in blocks]),
        np.concatenate([b.grasp_ids for b in blocks]),
        np.concatenate([b.feasible for b in blocks]),
    )


def _check_memory(feasible_wanted: int, pairs: float) -> None:
    needed, there = pairs * BYTES_PER_PAIR, machine_memory()
    if needed > there:
        raise OptionError(
            f"{feasible_wanted} samples need about {needed / 2**30:.3g} GB of memory, and this machine has "
            f"{there / 2**30:.3g} GB; ask for fewer samples"
        )


def label_poses(task: LabellingTask, count: int, *, jobs: int = -1) -> LabelledPoses:
    """Label every grasp at `count` random poses, drawn apart from those of `label_pairs`."""
    rng = np.random.default_rng([task.seed, 1])
    numbers, xi = random_poses(task.placements, task.workcell.bounds.array, count, rng)
    T = planar_transform(xi) @ task.placements[numbers]
    parts = np.array_split(T, 4 * joblib.effective_n_jobs(jobs))
    with workers(jobs, "generator") as parallel:
        feasible = list(parallel(joblib.delayed(_all_grasps)(task, part) for part in parts))
    return LabelledPoses(T, np.concatenate(feasible))


_checkers: dict[str, FeasibilityChecker] = {}


def _checker(task: LabellingTask) -> FeasibilityChecker:
    """Return the checker of `task`, built once a process."""
    key = task.fingerprint()
    if key not in _checkers:
        _checkers.clear()
        _checkers[key] = FeasibilityChecker(task.model, task.workcell, task.grasps)
    return _checkers[key]


def _all_grasps(task: LabellingTask, T: FloatArray) -> BoolArray:
    checker = _checker(task)
    rows = [checker.feasible(pose) for pose in T]
    return np.array(rows, dtype=bool).reshape(len(T), len(task.grasps))


def _block(task: LabellingTask, number: int, path: Path) -> LabelledPairs:
    stored = _read_block(path)
    if stored is not None:
        return stored
    rng = np.random.default_rng([task.seed, 0, number])
    placements, xi = random_poses(task.placements, task.workcell.bounds.array, POSES_PER_BLOCK, rng)
    T = planar_transform(xi) @ task.placements[placements]
    each = min(GRASPS_PER_POSE, len(task.grasps))
    ids = np.array([rng.choice(len(task.grasps), each, replace=False) for _ in range(POSES_PER_BLOCK)])
    labels = _checker(task).feasible_pairs(np.repeat(T, each, axis=0), ids.ravel())
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, T=T, grasp_ids=ids, feasible=labels.reshape(ids.shape))
    return LabelledPairs(np.repeat(T, each, axis=0), ids.ravel(), labels)


def _read_block(path: Path) -> LabelledPairs | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            T, ids, feasible = stored["T"], stored["grasp_ids"], stored["feasible"]
    except UNREADABLE_ARRAYS:
        return None
    if T.shape != (POSES_PER_BLOCK, 4, 4) or ids.shape != feasible.shape or len(ids) != len(T):
        return None
    return LabelledPairs(np.repeat(T, ids.shape[1], axis=0), ids.ravel(), feasible.ravel())
