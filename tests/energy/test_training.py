"""Training and calibration: options that make no sense, labels that hold one class, batches that do."""

import numpy as np
import pytest

from regrasp_opt.energy.calibration import area_under_roc, average_precision, best_threshold
from regrasp_opt.energy.training import PRESETS, TrainingOptions, train
from regrasp_opt.errors import ModelError, OptionError


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"activation": "relu6"}, "activation 'relu6' is unknown; use one of"),
        ({"features": "pixels"}, "features 'pixels' are unknown; use one of"),
        ({"hidden": 0}, "at least 1"),
        ({"epochs": 0}, "at least 1"),
        ({"batch_size": 0}, "at least 1"),
        ({"learning_rate": 0.0}, "learning_rate above 0"),
        ({"learning_rate": float("nan")}, "learning_rate above 0"),
    ],
)
def test_options_that_make_no_sense_are_refused(wrong, said):
    with pytest.raises(OptionError, match=said):
        TrainingOptions(**wrong)


@pytest.mark.parametrize("label", [True, False])
def test_labels_of_one_class_are_refused(label):
    with pytest.raises(ModelError, match="the training labels hold one class only"):
        train(np.zeros((4, 3)), np.full(4, label), TrainingOptions())


@pytest.mark.parametrize("loss", ["likelihood", "paper"])
def test_what_is_feasible_gets_the_lower_energy(loss):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(128, 13))
    feasible = features[:, 0] > 0
    seen = []
    options = TrainingOptions(hidden=8, epochs=20, batch_size=16, loss=loss, learning_rate=0.05)
    model = train(features, feasible, options, lambda done, total: seen.append((done, total)))
    assert seen == [(k, 20) for k in range(1, 21)]
    x = features.astype(np.float32)
    for W, b in zip(model.weights[:-1], model.biases[:-1], strict=True):
        z = x @ W.T + b
        x = z / (1 + np.exp(-z))
    energy = (x @ model.weights[-1].T + model.biases[-1])[:, 0]
    assert average_precision(energy, feasible) > 0.95 and area_under_roc(energy, feasible) > 0.95
    again = train(features, feasible, options)
    assert all((a == b).all() for a, b in zip(model.weights, again.weights, strict=True))


def test_batches_of_one_class_do_no_harm_to_the_papers_loss():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(64, 13))
    options = TrainingOptions(hidden=8, epochs=2, batch_size=1, loss="paper", alpha_reg=0.1)
    model = train(features, features[:, 0] > 0, options)  # without a contrast, only the penalty is left
    assert all(np.isfinite(W).all() for W in (*model.weights, *model.biases))


def test_the_presets_name_what_the_paper_uses():
    assert PRESETS["paper"].loss == "paper" and PRESETS["paper"].features == "paper" and not PRESETS["paper"].bounded
    assert PRESETS["default"] == TrainingOptions()


def test_figures_of_a_ranking():
    energy, positive = np.array([0.1, 0.2, 0.3, 0.4]), np.array([True, False, True, False])
    assert area_under_roc(energy, positive) == 0.75
    assert average_precision(energy, positive) == pytest.approx((1 + 2 / 3) / 2)
    assert best_threshold(energy, positive).f1 == pytest.approx(0.8)
    assert best_threshold(energy, positive).threshold == pytest.approx(0.35)


def test_without_both_classes_there_is_no_area_and_without_a_positive_no_threshold():
    energy, nothing = np.arange(3.0), np.zeros(3, dtype=bool)
    assert np.isnan(area_under_roc(energy, nothing)) and np.isnan(area_under_roc(energy, ~nothing))
    assert average_precision(energy, nothing) == 0.0
    for ranked, positive in ((energy, nothing), (energy[:0], nothing[:0])):
        with pytest.raises(ModelError, match="no held-out grasp is feasible, so the threshold cannot be calibrated"):
            best_threshold(ranked, positive)
    assert best_threshold(energy, ~nothing).f1 == 1.0
