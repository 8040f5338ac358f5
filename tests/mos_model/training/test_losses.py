"""The losses against references that follow the definitions."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from mos_model.training.losses import class_weights, lovasz_softmax, segmentation_loss
from runtime.errors import SettingError


def jaccard_loss(wrong: np.ndarray, foreground: np.ndarray) -> float:
    """1 - intersection / union of a class, given its `wrong` pixels (Berman et al., eq. 5)."""
    union = (foreground | wrong).sum()
    return float(wrong.sum() / union) if union else 0.0


def naive_lovasz(probabilities: np.ndarray, labels: np.ndarray) -> float:
    """The Lovasz extension by its definition: sum over falling errors m_i of m_i (D(first i) - D(before))."""
    losses = []
    for c in (1, 2):
        foreground = labels == c
        if not foreground.any():
            continue
        errors = np.where(foreground, 1 - probabilities[:, c], probabilities[:, c])
        wrong = np.zeros(len(labels), bool)
        loss, before = 0.0, 0.0
        for i in np.argsort(-errors):
            wrong[i] = True
            now = jaccard_loss(wrong, foreground)
            loss, before = loss + errors[i] * (now - before), now
        losses.append(loss)
    return float(np.mean(losses)) if losses else 0.0


def random_case(seed: int, count: int = 40) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    logits = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return logits, torch.randint(1, 3, (count,), generator=generator)


@pytest.mark.parametrize("seed", range(5))
def test_lovasz_equals_its_definition(seed):
    logits, labels = random_case(seed)
    p = logits.softmax(1)
    assert lovasz_softmax(p, labels).item() == pytest.approx(naive_lovasz(p.numpy(), labels.numpy()), abs=1e-12)


def test_lovasz_of_one_class_looks_at_that_class_only():
    logits, labels = random_case(0)
    p, labels = logits.softmax(1), torch.ones_like(labels)
    assert lovasz_softmax(p, labels).item() == pytest.approx(naive_lovasz(p.numpy(), labels.numpy()), abs=1e-12)


def test_lovasz_of_hard_predictions_is_the_mean_jaccard_loss():
    labels = torch.tensor([1, 1, 1, 2, 2, 1])
    predicted = torch.tensor([1, 2, 1, 2, 1, 1])
    expected = ((1 - 3 / 5) + (1 - 1 / 3)) / 2  # static: 3 of 5 in the union; moving: 1 of 3
    assert lovasz_softmax(F.one_hot(predicted, 3).double(), labels).item() == pytest.approx(expected)


def test_lovasz_gradient_is_right_numerically():
    logits, labels = random_case(3, 12)
    assert torch.autograd.gradcheck(lambda x: lovasz_softmax(x.softmax(1), labels), logits.requires_grad_())


def test_cross_entropy_equals_torch():
    logits = torch.randn(2, 3, 8, 16, generator=torch.Generator().manual_seed(1))
    labels = torch.randint(0, 3, (2, 8, 16), generator=torch.Generator().manual_seed(2))
    weights = torch.tensor([0.0, 1.3, 7.0])
    expected = F.cross_entropy(logits, labels, weights, ignore_index=0)
    loss = segmentation_loss(logits, labels.to(torch.uint8), weights)
    assert loss.cross_entropy.item() == pytest.approx(expected.item(), rel=1e-5)
    assert loss.total.item() == pytest.approx(loss.cross_entropy.item() + loss.lovasz.item())


def test_points_and_pixels_have_one_loss():
    logits, labels = random_case(4, 64)
    weights = torch.tensor([0.0, 1.0, 5.0])
    points = segmentation_loss(logits, labels, weights)
    pixels = segmentation_loss(logits.T.reshape(1, 3, 8, 8), labels.reshape(1, 8, 8), weights)
    assert points.total.item() == pytest.approx(pixels.total.item())


def test_ignored_pixels_change_neither_loss_nor_gradient():
    logits, labels = random_case(5)
    weights = torch.tensor([0.0, 1.0, 5.0])
    more = torch.cat([logits, torch.full((7, 3), 3.0, dtype=torch.float64)]).requires_grad_()
    loss = segmentation_loss(more, torch.cat([labels, torch.zeros(7, dtype=torch.int64)]), weights)
    loss.total.backward()
    assert loss.total.item() == pytest.approx(segmentation_loss(logits, labels, weights).total.item())
    assert not more.grad[40:].any()
    assert more.grad[:40].any()


def test_nothing_labelled_is_no_loss_and_no_nan():
    logits = torch.randn(1, 3, 4, 4, requires_grad=True)
    loss = segmentation_loss(logits, torch.zeros(1, 4, 4, dtype=torch.uint8), torch.tensor([0.0, 1.0, 5.0]))
    loss.total.backward()
    assert loss.total.item() == 0
    assert not logits.grad.any()


def test_class_weights():
    frequency = np.array([0.25, 0.74, 0.01])
    assert class_weights(frequency) == pytest.approx([0, 0.74**-0.5, 10])
    assert class_weights(frequency, "inverse") == pytest.approx([0, 1 / 0.741, 1 / 0.011])
    assert class_weights(np.array([0.5, 0.5, 0.0])) == pytest.approx([0, 2**0.5, 2**0.5])
    with pytest.raises(SettingError, match="inverse_sqrt"):
        class_weights(frequency, "median")
