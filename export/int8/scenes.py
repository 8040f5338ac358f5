"""The scans that ranges come from, and those on which the loss is measured, as the network sees them."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mos_model.data.dataset import SampleConfig, SimulatedStreets
from runtime.bundle.residual import HISTORY, Residual
from runtime.compute.workers import Workers
from runtime.doctor.check_scans import check_scans
from runtime.doctor.check_sensor import check_sensor
from runtime.doctor.sample import Sample
from runtime.errors import MosWarning, ScanError, SequenceError
from runtime.image.inputs import InputBuilder
from runtime.recordings.registry import open_recording
from runtime.sensors.range_image import RangeImage

CALIBRATION_STREETS = 16_000_000  # seeds of the simulated streets for ranges; nothing else has them
JUDGING_STREETS = 17_000_000  # and of those on which the loss is measured


class Scene(NamedTuple):
    """A scan as the network sees it."""

    image: np.ndarray  # (1, 5 + lags, H, W) f32
    labels: np.ndarray  # (H, W) 0 unlabelled, 1 static, 2 moving


def simulated(sensor: RangeImage, residual: Residual, first: int, count: int) -> list[Scene]:
    """Two scans of each of `count` simulated streets."""
    streets = SimulatedStreets(SampleConfig(sensor, residual), frames=2, every=4, first_street=first)
    return [Scene(sample.image[None], sample.labels) for number in range(count) for sample in streets.group(number)]


def recorded(folder: Path, sensor: RangeImage, residual: Residual, count: int = 16) -> list[np.ndarray]:
    """Images (1, channels, H, W) of `count` scans with a full history, spread over the sequence in `folder`.

    Raises SequenceError or ScanError where it cannot be used; warns of what does not look like the sensor.
    """
    recording = open_recording(folder)
    if len(recording) <= HISTORY:
        raise SequenceError(f"{folder}: has {len(recording)} scans; calibration needs at least {HISTORY + 1}")
    chosen = np.unique(np.linspace(HISTORY, len(recording) - 1, count).round().astype(int))
    samples = [Sample.of(recording.read(int(i)).data) for i in chosen]
    findings = check_scans(samples) + check_sensor(samples, sensor)
    for finding in sorted(findings, key=lambda finding: finding.level):  # bad, ok, warn
        text = f"{folder}: calibration data: {finding.topic}: {finding.text}"
        if finding.level == "bad":
            raise ScanError(f"{text}. Calibrate with scans that fit, or leave the calibration out (`calibration`)")
        if finding.level == "warn":
            warnings.warn(text, MosWarning, stacklevel=2)
    builder = InputBuilder(sensor, residual, Workers(1))
    images = []
    for index in chosen:
        scans = [recording.read(int(i)) for i in range(index - HISTORY, index + 1)]
        drive = [(scan.data, scan.known_pose()) for scan in scans]
        images.append(builder.image_of(drive)[1].image[None].copy())
    if not any(image[:, 5:].any() for image in images):
        warnings.warn(f"{folder}: calibration data: no residual image shows anything", MosWarning, stacklevel=2)
    return images
