"""The scans that ranges come from, and those on which the loss is measured, as the network sees them."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mos_model.data.dataset import SampleConfig, SimulatedStreets
from mos_model.data.mixture import MixedDrives
from runtime.bundle.residual import HISTORY
from runtime.bundle.view import SCAN_CHANNELS
from runtime.compute.workers import Workers
from runtime.doctor.demand import demand_fit
from runtime.errors import MosWarning, SequenceError
from runtime.image.making import make_inputs
from runtime.recordings.registry import open_recording

CALIBRATION_STREETS = 16_000_000  # seeds of the simulated streets for ranges; nothing else has them
JUDGING_STREETS = 17_000_000  # and of those on which the loss is measured


class Scene(NamedTuple):
    """A scan as the network sees it."""

    image: np.ndarray  # (1, channels, H, W) f32
    labels: np.ndarray  # (H, W) 0 unlabelled, 1 static, 2 moving


def simulated(samples: SampleConfig, first: int, count: int) -> list[Scene]:
    """Two scans of each of `count` simulated streets; of all sensors, where the network is for several."""
    drives = MixedDrives if samples.other_sensors else SimulatedStreets
    streets = drives(samples, frames=2, every=4, first_street=first)
    return [Scene(sample.image[None], sample.labels) for number in range(count) for sample in streets.group(number)]


def recorded(folder: Path, seen_as: SampleConfig, count: int = 16) -> list[np.ndarray]:
    """Images (1, channels, H, W) of `count` scans with a full history, spread over the sequence in `folder`.

    Raises SequenceError where it cannot be used, and of what `mos doctor` calls bad about it; warns of the rest.
    """
    recording = open_recording(folder)
    if len(recording) <= HISTORY:
        raise SequenceError(f"{folder}: has {len(recording)} scans; calibration needs at least {HISTORY + 1}")
    so = "it cannot calibrate: take scans that fit, or leave the calibration out (`calibration`)"
    demand_fit([recording], seen_as.range_image, so)
    chosen = np.unique(np.linspace(HISTORY, len(recording) - 1, count).round().astype(int))
    inputs = make_inputs(seen_as.view, Workers(1), seen_as.reach)
    images = []
    for index in chosen:
        scans = [recording.read(int(i)) for i in range(index - HISTORY, index + 1)]
        drive = [(scan.data, scan.known_pose()) for scan in scans]
        images.append(inputs.image_of(drive)[1].image[None].copy())
    if not any(image[:, SCAN_CHANNELS:].any() for image in images):
        warnings.warn(f"{folder}: calibration data: no residual image shows anything", MosWarning, stacklevel=2)
    return images
