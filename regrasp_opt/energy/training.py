"""Training of the energy in torch (appendix B of the paper).

The default loss is the negative log-likelihood of the labels, whose logit is the network's output: for a bounded
energy that *is* ``E`` for feasible pairs and ``-log(1 - exp(-E))`` for the others. The paper's loss adds a likelihood
normalised over the batch, a contrastive term and a penalty on large energies.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.energy.features import FEATURE_SETS, FeatureSet
from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.energy.network import ACTIVATIONS, Activation, TorchNetwork, evaluate
from regrasp_opt.errors import ModelError, OptionError
from regrasp_opt.threads import one_torch_thread

if TYPE_CHECKING:
    import torch

Loss = Literal["likelihood", "paper"]

LABEL_NOISE = 1e-5
"""Probability that a label is taken to be wrong: keeps energies below about 11.5 and gradients out of the denormals."""


@dataclass(frozen=True)
class TrainingOptions:
    """What is trained, and how; the defaults are ours, `PRESETS["paper"]` is the paper's.

    Both hidden layers are `hidden` wide. For `activation`, `features` and `bounded` see `regrasp_opt.energy`; the paper
    leaves out the jaw width (`use_width`) to compare end-effectors. `alpha_reg` weighs the paper's penalty on large
    energies. AdamW with a one-cycle schedule runs on the torch `device`; ``"auto"`` takes a GPU where there is one.
    """

    hidden: int = 64
    activation: Activation = "silu"
    features: FeatureSet = "tcp"
    use_width: bool = True
    bounded: bool = True
    loss: Loss = "likelihood"
    alpha_reg: float = 1e-3
    epochs: int = 30
    batch_size: int = 1024
    learning_rate: float = 6e-3
    weight_decay: float = 1e-4
    seed: int = 0
    device: str = "auto"

    def __post_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            raise OptionError(f"activation '{self.activation}' is unknown; use one of {', '.join(ACTIVATIONS)}")
        if self.features not in FEATURE_SETS:
            raise OptionError(f"features '{self.features}' are unknown; use one of {', '.join(FEATURE_SETS)}")
        if min(self.hidden, self.epochs, self.batch_size) < 1 or not self.learning_rate > 0:
            raise OptionError("training needs hidden, epochs and batch_size of at least 1 and a learning_rate above 0")


PRESETS: dict[str, TrainingOptions] = {
    "default": TrainingOptions(),
    "paper": TrainingOptions(
        hidden=128, activation="selu", features="paper", bounded=False, loss="paper", epochs=20, learning_rate=2e-3
    ),
}


def train(
    features: FloatArray,
    feasible: BoolArray,
    options: TrainingOptions,
    progress: Callable[[int, int], None] | None = None,
) -> EnergyModel:
    """Train an energy on `features` (M, F) and labels `feasible` (M,); its threshold is not calibrated yet.

    `progress` is called with (epochs done, epochs in all).

    Raises
    ------
    ModelError
        If the labels hold one class only.
    """
    import torch

    if feasible.all() or not feasible.any():
        raise ModelError("the training labels are all of one class; sample more poses or widen the workspace")
    wanted = ("cuda" if torch.cuda.is_available() else "cpu") if options.device == "auto" else options.device
    device = torch.device(wanted)
    generator = torch.Generator().manual_seed(options.seed)
    mean, std = features.mean(axis=0), features.std(axis=0)
    std = np.where(std > 1e-6, std, 1.0)
    x = torch.as_tensor((features - mean) / std, dtype=torch.float32).to(device)
    y = torch.as_tensor(feasible, dtype=torch.float32).to(device)
    sizes, layers = [features.shape[1], options.hidden, options.hidden, 1], []
    for fan_in, fan_out in itertools.pairwise(sizes):
        W = torch.randn(fan_out, fan_in, generator=generator) * fan_in**-0.5
        layers.append((W.to(device).requires_grad_(), torch.zeros(fan_out, device=device).requires_grad_()))
    parameters = [p for layer in layers for p in layer]
    optimiser = torch.optim.AdamW(parameters, lr=options.learning_rate, weight_decay=options.weight_decay)
    batches = -(-len(y) // options.batch_size)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, options.learning_rate, total_steps=options.epochs * batches
    )
    network = TorchNetwork()
    with _steadily():
        for epoch in range(options.epochs):
            order = torch.randperm(len(y), generator=generator).to(device)
            for batch in order.split(options.batch_size):
                optimiser.zero_grad(set_to_none=True)
                z = network.affine(x[batch], *layers[0])
                f = evaluate(network, layers[1:], options.activation, False, z)[:, 0]
                training_loss(f, y[batch], options).backward()
                optimiser.step()
                schedule.step()
            if progress is not None:
                progress(epoch + 1, options.epochs)
    return _export(layers, mean, std, options)


@contextmanager
def _steadily() -> Iterator[None]:
    """Train on one thread, without denormals.

    Batches are too small to gain from a second thread, and on a busy machine threads that wait for each other cost a
    factor of ten. Saturated units leave denormal gradients, which cost as much.
    """
    import torch

    torch.set_flush_denormal(True)
    try:
        with one_torch_thread():
            yield
    finally:
        torch.set_flush_denormal(False)


def training_loss(f: torch.Tensor, y: torch.Tensor, options: TrainingOptions) -> torch.Tensor:
    """Return the loss of network outputs `f` (B,) for labels `y` (B,), 1 where feasible (appendix B of the paper)."""
    import torch

    if options.loss == "likelihood":  # f is the logit of being infeasible
        soft = y.clamp(LABEL_NOISE, 1 - LABEL_NOISE)
        return torch.nn.functional.binary_cross_entropy_with_logits(-f, soft)
    good, bad = f[y > 0.5], f[y < 0.5]
    penalty = options.alpha_reg * (f * f).mean()
    if len(good) == 0 or len(bad) == 0:
        return penalty
    likelihood = good.mean() + torch.logsumexp(-f, 0) - np.log(len(f))
    contrast = torch.nn.functional.softplus(good[:, None] - bad[None, :]).mean()
    return likelihood + contrast + penalty


def _export(
    layers: list[tuple[torch.Tensor, torch.Tensor]], mean: FloatArray, std: FloatArray, options: TrainingOptions
) -> EnergyModel:
    """Return the trained weights with the standardisation of the inputs folded into the first layer."""
    arrays = [[t.detach().cpu().numpy().astype(np.float64) for t in layer] for layer in layers]
    arrays[0][0] /= std
    arrays[0][1] -= arrays[0][0] @ mean
    weights, biases = (tuple(array.astype(np.float32) for array in part) for part in zip(*arrays, strict=True))
    kept = asdict(options)
    kept.pop("device")
    network = options.activation, options.features, options.use_width, options.bounded
    return EnergyModel(weights, biases, *network, threshold=float("nan"), metadata={"training": kept})
