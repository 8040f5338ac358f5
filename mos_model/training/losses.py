"""The paper's loss (Sec. III-E): weighted cross-entropy plus Lovasz-Softmax, class 0 (unlabelled) ignored."""

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from runtime.classes import UNLABELLED
from runtime.errors import SettingError

IGNORED = UNLABELLED  # class that no loss looks at


class Loss(NamedTuple):
    """`total` = `cross_entropy` + `lovasz`; scalars."""

    total: Tensor
    cross_entropy: Tensor
    lovasz: Tensor


def class_weights(frequency: NDArray[np.float64], kind: str = "inverse_sqrt") -> NDArray[np.float32]:
    """Weight (C,) f32 of each class from its share of all pixels, (C,) in 0..1; the ignored class gets 0.

    "inverse_sqrt": 1 / sqrt(f), the paper's equation. "inverse": 1 / (f + 0.001), as in the published
    training. A class that never occurs has no term in the loss; it gets the largest weight of the others.
    """
    f = np.asarray(frequency, np.float64)
    labelled = np.arange(len(f)) != IGNORED
    if kind == "inverse_sqrt":
        weights = 1 / np.sqrt(np.where(f > 0, f, np.inf))
    elif kind == "inverse":
        weights = np.where(f > 0, 1 / (f + 0.001), 0)
    else:
        raise SettingError(f"class weights must be 'inverse_sqrt' or 'inverse', not {kind!r}")
    weights[~labelled] = 0
    return np.where(labelled & (f == 0), weights.max(initial=1), weights).astype(np.float32)


def lovasz_gradient(foreground: Tensor) -> Tensor:
    """Slopes of the Lovasz extension of the Jaccard loss (Berman et al., CVPR 2018, Alg. 1).

    foreground: (P,) f32, 1 where a pixel is of the class, pixels by falling error. Returns (P,) f32.
    """
    total = foreground.sum()
    found = foreground.cumsum(0)
    position = torch.arange(1, len(foreground) + 1, device=foreground.device, dtype=foreground.dtype)
    jaccard = 1 - (total - found) / (total + position - found)
    return torch.diff(jaccard, prepend=jaccard.new_zeros(1))


def _falling(errors: Tensor) -> Tensor:
    """Indices (P,) that sort `errors` from large to small; NumPy sorts several times as fast as PyTorch on a CPU."""
    if errors.device.type != "cpu":
        return errors.argsort(descending=True)
    return torch.from_numpy(np.argsort(-errors.numpy()))


def lovasz_softmax(probabilities: Tensor, labels: Tensor) -> Tensor:
    """Lovasz-Softmax over the classes that are present, all pixels of the batch together.

    probabilities: (P, C) f32; labels: (P,) int64, none ignored. Returns a scalar (0 without pixels).
    """
    losses = []
    for c in range(probabilities.shape[1]):
        foreground = labels == c
        if c == IGNORED or not foreground.any():
            continue
        errors = torch.where(foreground, 1 - probabilities[:, c], probabilities[:, c])
        with torch.no_grad():  # the slopes are constant where the order of the errors is
            order = _falling(errors)
            slopes = torch.empty_like(errors)
            slopes[order] = lovasz_gradient(foreground[order].to(errors.dtype))
        losses.append(errors @ slopes)
    return torch.stack(losses).mean() if losses else probabilities.sum() * 0


def segmentation_loss(logits: Tensor, labels: Tensor, weights: Tensor) -> Loss:
    """Both losses, one to one, of logits (B, C, H, W) or (N, C) against labels (B, H, W) or (N,), any
    integer.

    weights: (C,) f32, of the cross-entropy, whose mean is over the weights of the labelled pixels. In
    float32.
    """
    flat = logits.movedim(1, -1).reshape(-1, logits.shape[1])
    labelled = labels.reshape(-1) != IGNORED
    target = labels.reshape(-1)[labelled].long()
    log_probabilities = F.log_softmax(flat[labelled].float(), dim=1)  # (P, C)
    weight = weights[target]
    picked = log_probabilities.gather(1, target[:, None])[:, 0]
    cross_entropy = -(weight * picked).sum() / weight.sum().clamp_min(1e-12)
    lovasz = lovasz_softmax(log_probabilities.exp(), target)
    return Loss(cross_entropy + lovasz, cross_entropy, lovasz)
