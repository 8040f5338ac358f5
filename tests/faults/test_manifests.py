"""A manifest of a stranger: whatever stands in it, it is refused at load, or the runner does as it should."""

import json
import math

import pytest

from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.loading import load_bundle
from runtime.bundle.manifest import MANIFEST, SensorEntry, Tuned
from runtime.bundle.residual import Residual
from runtime.commands.main import main
from runtime.errors import BundleError, SettingError
from runtime.image.projection import EXACT, pixel_scale
from runtime.sensors.range_image import RangeImage
from runtime.sensors.sensor import Sensor

NUMBERS = [
    ('"fov_up": 3.0, "fov_down": -25.0', '"fov_up": 1e-300, "fov_down": 0'),  # an angle by which a kernel divides
    ('"fov_up": 3.0', '"fov_up": 1e400'),
    ('"fov_up": 3.0', '"fov_up": "3"'),
    ('"height": 64', '"height": 262144'),  # more pixels than float32 counts
    ('"width": 256', '"width": 256.0'),
    ('"reach": ', '"reach": 1e300, "x": '),
    ('"halo": 0.6', f'"halo": 1{400 * "0"}'),
    ('"voxel_size": ', '"voxel_size": 1e-300, "x": '),
    ('"std": [', '"std": [1e-300, '),
    ('"mean": [', '"mean": [1e300, '),
]


def spoil(bundle, change):
    """Let `change` work on the text of the manifest."""
    text = json.dumps(json.loads((bundle / MANIFEST).read_text()))
    changed = change(text)
    assert changed != text
    (bundle / MANIFEST).write_text(changed)
    return bundle


def check_refused(bundle, capfd):
    """By the library and by the command, in one line."""
    with pytest.raises(BundleError):
        load_bundle(bundle)
    assert main(["info", str(bundle)]) == 1
    assert len(capfd.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(("old", "new"), NUMBERS)
def test_numbers_that_cannot_be(bundle, capfd, old, new):
    check_refused(spoil(bundle, lambda text: text.replace(old, new, 1)), capfd)


@pytest.mark.parametrize("levels", [40, 900, 100_000])
def test_what_is_nested_deeply(bundle, capfd, levels):
    nested = f'"accuracy": {{"x": {levels * "["}{levels * "]"}}}, "y": '
    check_refused(spoil(bundle, lambda text: text.replace('"accuracy": ', nested)), capfd)


def test_a_manifest_without_end(bundle, capfd):
    with (bundle / MANIFEST).open("r+") as file:
        file.truncate(1 << 40)
    check_refused(bundle, capfd)


def test_a_head_of_many_stages(bundle, capfd):
    """Whose receptive field takes 2^stages steps to tell."""

    def change(text):
        values = json.loads(text)
        values["point_head"] |= {"down": [8] * 60, "up": [8] * 60, "fuse_after_up": None}
        return json.dumps(values)

    check_refused(spoil(bundle, change), capfd)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (RangeImage, {"mean": (math.nan, 0, 0, 0, 0)}),
        (RangeImage, {"std": (math.nan, 1, 1, 1, 1)}),
        (RangeImage, {"elevations": (2.0, math.nan, -2.0)}),
        (RangeImage, {"fov_up": math.nan}),
        (Residual, {"max_range": math.inf}),
        (Residual, {"min_range": math.nan}),
        (Tuned, {"halo": math.inf}),
        (PointHeadConfig, {"voxel_size": math.nan}),
        (PointHeadConfig, {"dropout": math.nan}),
        (SensorEntry, {"name": "x", "range_image": RangeImage(), "reach": math.inf}),
        (Sensor, {"name": "x", "elevations": (1.0, math.nan, -1.0), "azimuth_steps": 1800}),
        (Sensor, {"name": "x", "elevations": (1.0, -1.0), "azimuth_steps": 1800, "lifts": ()}),
    ],
)
def test_nan_is_no_setting(kind, values):
    with pytest.raises(SettingError):
        kind(**values)


def test_bins_of_a_wide_view_are_counted_exactly():
    bins, width, *_, rows = pixel_scale(RangeImage(16, 4096, 90.0, -90.0, elevations=(60.0, -60.0)))
    assert bins == len(rows)
    assert bins * width <= EXACT
