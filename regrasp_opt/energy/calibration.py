"""How good an energy is on held-out labels, and the threshold `h` of Eq. 3 (appendix A of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.errors import ModelError

_PAIRS = 500


class BestThreshold(NamedTuple):
    """The threshold with the highest F1, and that F1."""

    threshold: float
    f1: float


def average_precision(energy: FloatArray, positive: BoolArray) -> float:
    """Return the area under the precision-recall curve of ranking `positive` (M,) by low `energy` (M,)."""
    hits = positive[np.argsort(energy, kind="stable")]
    precision = np.cumsum(hits) / np.arange(1, len(hits) + 1)
    return float(precision[hits].mean()) if hits.any() else 0.0


def area_under_roc(energy: FloatArray, positive: BoolArray) -> float:
    """Return the probability that a random positive has a lower energy than a random negative (ties count half)."""
    from scipy.stats import rankdata  # takes a quarter of a second, and only training asks

    ranks = rankdata(-energy)
    count = int(positive.sum())
    negatives = len(positive) - count
    if count == 0 or negatives == 0:
        return float("nan")
    return float((ranks[positive].sum() - count * (count + 1) / 2) / (count * negatives))


def reliability_curve(probability: FloatArray, positive: BoolArray, bins: int = 10) -> list[dict[str, float]]:
    """Return mean prediction, share of positives and count of each bin of predicted probability that is not empty."""
    index = np.minimum((probability * bins).astype(int), bins - 1)
    return [
        {
            "predicted": float(probability[index == b].mean()),
            "observed": float(positive[index == b].mean()),
            "count": int((index == b).sum()),
        }
        for b in range(bins)
        if (index == b).any()
    ]


def best_threshold(energy: FloatArray, positive: BoolArray) -> BestThreshold:
    """Return the threshold on `energy` (M,) that classifies `positive` (M,) with the highest F1.

    Raises a `ModelError` if nothing is positive.
    """
    order = np.argsort(energy, kind="stable")
    hits = np.cumsum(positive[order])
    if len(hits) == 0 or hits[-1] == 0:
        raise ModelError(
            "no held-out grasp is feasible, so the threshold cannot be calibrated; prepare with more samples"
        )
    f1 = 2 * hits / (np.arange(1, len(hits) + 1) + hits[-1])
    best = int(f1.argmax())
    upper = energy[order[min(best + 1, len(order) - 1)]]
    return BestThreshold(float((energy[order[best]] + upper) / 2), float(f1[best]))


class HeldOut(NamedTuple):
    """Energies (B, G) of all grasps of an object at B poses that training has not seen, and their feasibility."""

    energies: FloatArray
    feasible: BoolArray


def calibrate(model: EnergyModel, objects: Sequence[HeldOut], seed: int = 0) -> EnergyModel:
    """Return `model` with `h` set and its metrics on held-out poses of one or more objects recorded.

    `h` maximises F1 of telling shared from other grasps over random pairs of the held-out poses (appendix A).
    """
    rng = np.random.default_rng(seed)
    sums, both = [], []
    for energies, feasible in objects:
        a, b = (rng.integers(len(energies), size=_PAIRS) for _ in range(2))
        sums.append((energies[a] + energies[b]).ravel())
        both.append((feasible[a] & feasible[b]).ravel())
    shared = best_threshold(np.concatenate(sums), np.concatenate(both))
    flat, positive = (np.concatenate([part.ravel() for part in parts]) for parts in zip(*objects, strict=True))
    single = best_threshold(flat, positive)
    metrics = {
        "average_precision": average_precision(flat, positive),
        "auroc": area_under_roc(flat, positive),
        "reliability": reliability_curve(np.exp(-flat) if model.bounded else expit(-flat), positive),
        "f1": single.f1,
        "threshold": single.threshold,
        "shared_f1": shared.f1,
        "feasible_share": float(positive.mean()),
        "poses": sum(len(each.feasible) for each in objects),
    }
    return replace(model, threshold=shared.threshold, metadata={**model.metadata, "held_out": metrics})
