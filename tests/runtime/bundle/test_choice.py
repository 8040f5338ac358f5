"""Which sensor a bundle is run for, and by which thresholds."""

from dataclasses import replace

import numpy as np

from runtime.bundle.choice import choose_before, choose_from
from runtime.bundle.loading import load_bundle
from runtime.sensors.finding import Found
from runtime.sensors.registry import SENSORS
from runtime.sensors.sensor import Sensor, even
from tests.support.bundles import for_sensors
from tests.support.paths import BUNDLE


def test_a_bundle_for_one_sensor_takes_scans_for_its_own(tmp_path):
    manifest = load_bundle(BUNDLE).manifest
    assert choose_before(manifest, None).entry == manifest.sensor
    many = load_bundle(for_sensors(tmp_path, "hdl64e", "vlp16")).manifest
    assert choose_before(many, None) is None


def test_a_listed_sensor_has_its_entry_and_another_the_thresholds_of_the_nearest(tmp_path):
    manifest = load_bundle(for_sensors(tmp_path, "hdl64e", "vlp16")).manifest
    assert choose_before(manifest, SENSORS["vlp16"]).entry == manifest.sensors[1]
    for name, nearest in (("pandar64", 0), ("xt16", 1), ("os1-32", 1)):
        choice = choose_before(manifest, SENSORS[name])
        assert choice.entry.name == name
        assert choice.entry.range_image == SENSORS[name].range_image
        assert choice.entry.decision == manifest.sensors[nearest].decision
        assert manifest.sensors[nearest].name in choice.text


def test_a_listed_sensor_at_another_speed_keeps_its_thresholds(tmp_path):
    manifest = load_bundle(for_sensors(tmp_path, "hdl64e", "vlp16")).manifest
    quick = SENSORS["vlp16"].spinning(2.0)
    entry = choose_before(manifest, quick).entry
    assert (entry.range_image.width, entry.decision) == (896, manifest.sensors[1].decision)


def test_the_normalisation_is_that_of_the_network(tmp_path):
    manifest = load_bundle(for_sensors(tmp_path, "hdl64e", "vlp16")).manifest
    image = replace(manifest.sensors[1].range_image, mean=(1.0,) * 5, std=(2.0,) * 5)
    manifest = replace(manifest, sensors=(manifest.sensor, replace(manifest.sensors[1], range_image=image)))
    own = Sensor("own", even(10.0, -10.0, 16), 900)
    assert choose_before(manifest, own).entry.range_image == replace(own.range_image, mean=image.mean, std=image.std)


def test_what_was_found_brings_its_mounting(tmp_path):
    manifest = load_bundle(for_sensors(tmp_path, "hdl64e", "vlp16")).manifest
    choice = choose_from(manifest, Found(SENSORS["vlp16"], "vlp16", "as vlp16", np.eye(4)))
    assert choice.entry == manifest.sensors[1]
    assert choice.mounting is not None
