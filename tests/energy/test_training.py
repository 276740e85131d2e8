"""Training and calibration: options that make no sense, labels that hold one class, batches that do."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from regrasp_opt.energy.calibration import area_under_roc, average_precision, best_threshold
from regrasp_opt.energy.training import LABEL_NOISE, PRESETS, TrainingOptions, train, training_loss
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
    with pytest.raises(ModelError, match="the training labels are all of one class"):
        train(np.zeros((4, 3)), np.full(4, label), TrainingOptions())


@pytest.mark.parametrize("loss", ["likelihood", "paper"])
def test_what_is_feasible_gets_the_lower_energy(loss):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(128, 13)) * np.logspace(-2, 2, 13) + np.linspace(-300, 300, 13)
    features[:, 1] = 0.7  # an input that never changes
    feasible = features[:, 0] > features[:, 0].mean()
    seen = []
    options = TrainingOptions(hidden=8, epochs=20, batch_size=16, loss=loss, learning_rate=0.05)
    threads = torch.get_num_threads()
    model = train(features, feasible, options, lambda done, total: seen.append((done, total)))
    assert seen == [(k, 20) for k in range(1, 21)]
    assert torch.get_num_threads() == threads
    x = features
    for W, b in zip(model.weights[:-1], model.biases[:-1], strict=True):
        z = x @ W.T + b
        x = z / (1 + np.exp(-z))
    energy = (x @ model.weights[-1].T + model.biases[-1])[:, 0]
    assert average_precision(energy, feasible) > 0.95 and area_under_roc(energy, feasible) > 0.95
    again, other = train(features, feasible, options), train(features, feasible, replace(options, seed=1))
    assert all((a == b).all() for a, b in zip(model.weights, again.weights, strict=True))
    assert not np.allclose(model.weights[-1], other.weights[-1])
    assert [W.shape for W in model.weights] == [(8, 13), (8, 8), (1, 8)] and np.isnan(model.threshold)
    assert (model.activation, model.features, model.use_width, model.bounded) == ("silu", "tcp", True, True)
    assert model.metadata["training"]["loss"] == loss and "device" not in model.metadata["training"]


PAPER = TrainingOptions(loss="paper", alpha_reg=0.0)
OUTPUTS, LABELS = torch.tensor([-1.0, 0.5, 2.0, 3.0, 0.1]), torch.tensor([1.0, 1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("feasible", [1, 2, 4])
def test_the_papers_loss_is_a_normalised_likelihood_and_a_contrast(feasible):
    """``-log(exp(-E) / mean exp(-E))`` of the feasible ones, and ``log(1 + exp(E_good - E_bad))`` of all pairs."""
    good, bad = OUTPUTS[:feasible].numpy(), OUTPUTS[feasible:].numpy()
    labels = (torch.arange(5) < feasible).float()
    density = np.exp(-good) / np.exp(-OUTPUTS.numpy()).mean()
    contrast = np.mean([np.log(1 + np.exp(g - b)) for g in good for b in bad])
    assert float(training_loss(OUTPUTS, labels, PAPER)) == pytest.approx(-np.log(density).mean() + contrast, rel=1e-5)


def test_the_papers_loss_knows_energies_up_to_a_constant_only():
    """The partition function takes a shift out, so that no energy is lowered by lowering all; the penalty does not."""
    shifted = [float(training_loss(OUTPUTS + shift, LABELS, PAPER)) for shift in (-7.0, 0.0, 7.0)]
    assert shifted == pytest.approx([shifted[1]] * 3, rel=1e-5)
    f = OUTPUTS.clone().requires_grad_()
    training_loss(f, LABELS, PAPER).backward()
    assert float(f.grad.sum()) == pytest.approx(0.0, abs=1e-6)
    assert float(f.grad[:2].sum()) > 0 and (f.grad[2:] < 0).all()  # descent lowers the feasible and raises the others
    for alpha in (0.1, 2.0):
        penalised = training_loss(OUTPUTS, LABELS, replace(PAPER, alpha_reg=alpha))
        assert float(penalised) == pytest.approx(shifted[1] + alpha * float((OUTPUTS**2).mean()), rel=1e-5)


def test_the_likelihood_is_that_of_labels_with_noise():
    """It is least where the odds are those of a wrong label, at about 11.5; softplus(f) is -log p(feasible)."""
    plain = TrainingOptions()
    value = float(training_loss(OUTPUTS, LABELS, plain))
    f = OUTPUTS.numpy().astype(float)
    expected = np.where(LABELS.numpy() > 0.5, np.log1p(np.exp(f)), np.log1p(np.exp(-f)))
    assert value == pytest.approx(expected.mean(), rel=1e-4)
    sure = np.log(1 / LABEL_NOISE - 1)
    assert sure == pytest.approx(11.5, abs=0.1)
    for label, at in ((0.0, sure), (1.0, -sure)):
        f = torch.tensor([at - 1, at, at + 1], dtype=torch.float64).requires_grad_()
        losses = [training_loss(each[None], torch.tensor([label], dtype=torch.float64), plain) for each in f]
        sum(losses).backward()
        assert f.grad[0] < 0 < f.grad[2] and float(f.grad[1]) == pytest.approx(0.0, abs=1e-8)


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
