"""What an image network returns."""

from typing import NamedTuple

from torch import Tensor


class ImageOutput(NamedTuple):
    """Class scores and features of every pixel."""

    logits: Tensor  # (B, 3, H, W) scores of the classes before softmax
    features: Tensor  # (B, c, H, W / s) for the point head: s neighbouring pixels of a row share theirs

    def features_at(self, image: int, pixel: Tensor) -> Tensor:
        """Features (N, c) of the pixels v * W + u (N,) of one image of the batch."""
        share = self.logits.shape[3] // self.features.shape[3]
        return self.features[image].flatten(1)[:, pixel // share].T
