"""A network for another sensor than the default one is compared, calibrated and judged on scans of its own."""

import dataclasses

import pytest

import mos_model.simulator
from export.bundle import parity
from export.convert import export_checkpoint
from export.int8.quantise import Settings
from export.int8.scenes import CALIBRATION_STREETS, JUDGING_STREETS, simulated
from mos_model.data.dataset import SampleConfig
from mos_model.networks import checkpoint
from mos_model.networks.registry import named_config
from mos_model.simulator import simulate
from runtime.compute.workers import Workers
from runtime.sensors.registry import SENSORS, find_sensor
from tests.support.make_tiny import random_network

IMAGE = dataclasses.replace(SENSORS["vlp16"].range_image, width=64)
CONFIG = named_config("rt", 4, name="tiny-16", sensor="vlp16", range_image=IMAGE, widths=(4, 8))


@pytest.fixture
def asked(monkeypatch):
    """Which sensor was simulated, by the number of the street; it gets a tenth of its columns."""
    seen = {}

    def watched(seed, frames, sensor, **settings):
        seen[seed] = sensor
        return simulate(seed, frames, dataclasses.replace(find_sensor(sensor), azimuth_steps=180), **settings)

    monkeypatch.setattr(parity, "simulate", watched)
    monkeypatch.setattr(mos_model.simulator, "simulate", watched)
    return seen


def test_parity_calibration_and_judge_see_its_scans(asked, tmp_path):
    checkpoint.save(tmp_path / "a.pt", CONFIG, random_network(CONFIG)[0], None, {"trained": False})
    settings = Settings(streets=1, judging=1, threads=1)
    manifest = export_checkpoint(tmp_path / "a.pt", tmp_path / "out", precision="int8", int8=settings).bundle.manifest
    assert asked == dict.fromkeys((parity.SEED, CALIBRATION_STREETS, JUDGING_STREETS), "vlp16")
    assert (manifest.sensor.name, manifest.sensor.range_image) == ("vlp16", IMAGE)
    assert manifest.sensor.reach == SENSORS["vlp16"].reach
    _, image = parity.simulated_input(manifest, Workers(1))
    assert (image.nearest > 0).any(axis=1).all()  # scans of an HDL-64E leave the upper rows empty


def test_scenes_are_seen_as_the_network_sees_them(asked):
    scene, _ = simulated(SampleConfig.of(CONFIG), CALIBRATION_STREETS, 1)
    assert scene.image.shape == (1, 13, 16, 64)
    assert (scene.labels > 0).any(axis=1).all()
