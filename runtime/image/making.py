"""Which inputs a view needs: the one place that tells views apart."""

from typing import Any

from runtime.bundle.view import View
from runtime.compute.workers import Workers
from runtime.image.bird_inputs import BirdInputBuilder
from runtime.image.cylinder_inputs import CylinderInputBuilder
from runtime.image.inputs import InputBuilder, Inputs


def make_inputs(view: View, workers: Workers, *entry: Any) -> Inputs:
    """entry: reach, nearest, body and mounting, as of `Inputs`."""
    if view.bird is not None:
        return BirdInputBuilder(view.bird, view.range_image, view.residual, workers, *entry)
    if view.cylinder is not None:
        return CylinderInputBuilder(view.cylinder, view.range_image, view.residual, workers, *entry)
    return InputBuilder(view.range_image, view.residual, workers, *entry)
