"""What a stage of the training trains: the modules, how a batch goes through them, and what is saved."""

from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from mos_model.data.dataset import Sample
from mos_model.networks import checkpoint
from mos_model.networks.config import ModelConfig
from mos_model.training.losses import Loss, segmentation_loss
from runtime.classes import MOVING, STATIC
from runtime.errors import SettingError


class Scored(NamedTuple):
    """What a batch gave."""

    loss: Loss
    labels: Tensor  # classes, any shape
    predicted: Tensor  # static or moving, of the same shape


class Task(ABC):
    """One of the two stages. `trained` is what the optimiser changes."""

    config: ModelConfig
    trained: nn.Module

    def __init__(self, weights: Tensor, device: torch.device) -> None:
        """weights: (3,) of the classes in the cross-entropy."""
        self.weights, self.device = weights.to(device), device

    @abstractmethod
    def forward(self, trained: nn.Module, batch: list[Sample]) -> tuple[Tensor, Tensor]:
        """Logits (B, 3, ...) and labels (B, ...); `trained` may be wrapped for several processes."""

    @abstractmethod
    def save(self, path: Path, training: dict[str, Any]) -> None:
        """Write a checkpoint."""

    def score(self, trained: nn.Module, batch: list[Sample]) -> Scored:
        """Loss and predictions of a batch."""
        logits, labels = self.forward(trained, batch)
        moving = logits.detach()[:, MOVING] > logits.detach()[:, STATIC]
        return Scored(
            segmentation_loss(logits, labels, self.weights), labels, torch.where(moving, MOVING, STATIC).to(torch.uint8)
        )

    def to_device(self, arrays: list[np.ndarray], fill: float = 0) -> Tensor:
        """One tensor (B, ...) of arrays that are equal, but for the length of lists of points: filled up at the end."""
        longest = max(array.shape[-1] for array in arrays)
        filled = [
            np.pad(array, [(0, 0)] * (array.ndim - 1) + [(0, longest - array.shape[-1])], constant_values=fill)
            if array.shape[-1] < longest
            else array
            for array in arrays
        ]
        return torch.from_numpy(np.stack(filled)).to(self.device)


class ImageTask(Task):
    """Stage 1: the image network, on pixels."""

    def __init__(self, config: ModelConfig, weights: Tensor, device: torch.device) -> None:
        super().__init__(weights, device)
        self.config = replace(config, point_head=None)
        self.layout = torch.channels_last if config.channels_last else torch.contiguous_format
        self.trained = config.build_image_network().to(device).to(memory_format=self.layout)  # type: ignore[call-overload]

    def forward(self, trained: nn.Module, batch: list[Sample]) -> tuple[Tensor, Tensor]:
        """See `Task`."""
        image = self.to_device([sample.image for sample in batch], fill=-1)  # (B, channels, H, W); no point has cell -1
        image = image.contiguous(memory_format=self.layout)
        return trained(image).logits, self.to_device([sample.labels for sample in batch])

    def save(self, path: Path, training: dict[str, Any]) -> None:
        """See `Task`."""
        checkpoint.save(path, self.config, self.trained, training=training)


class PointTask(Task):
    """Stage 2: the point head, on points; the image network is frozen."""

    def __init__(self, config: ModelConfig, image_net: nn.Module, weights: Tensor, device: torch.device) -> None:
        super().__init__(weights, device)
        head = config.build_point_head()
        if head is None:
            raise SettingError(f"{config.name} has no point head to train: choose v2 or v2-lite, or stage 1")
        self.config = config
        self.image_net = image_net.to(device).eval().requires_grad_(False)
        self.head = self.trained = head.to(device)

    def forward(self, trained: nn.Module, batch: list[Sample]) -> tuple[Tensor, Tensor]:
        """See `Task`."""
        with torch.no_grad():
            output = self.image_net(self.to_device([sample.image for sample in batch], fill=-1))
        parts, xyz, scan, labels = [], [], [], []
        for b, sample in enumerate(batch):
            pixel = torch.from_numpy(sample.pixel).to(self.device, torch.int64)
            parts.append(output.features_at(b, pixel))  # (N, c)
            xyz.append(torch.from_numpy(sample.xyz).to(self.device))
            scan.append(torch.full_like(pixel, b))
            labels.append(torch.from_numpy(sample.classes).to(self.device))
        grid = self.head.grid(torch.cat(xyz), torch.cat(scan))
        return trained(grid, torch.cat(parts)), torch.cat(labels)

    def save(self, path: Path, training: dict[str, Any]) -> None:
        """See `Task`."""
        checkpoint.save(path, self.config, self.image_net, self.trained, training=training)
