"""`mos info`."""

from pathlib import Path

from runtime.commands.main import main
from tests.support.paths import BUNDLE


def test_info_tells_nested_and_absent_values(capsys):
    from runtime.bundle.head_shape import LITE
    from runtime.bundle.loading import Bundle
    from runtime.bundle.manifest import FileEntry, Manifest, SensorEntry
    from runtime.bundle.residual import Residual
    from runtime.commands.info import show_bundle
    from runtime.sensors.range_image import RangeImage

    manifest = Manifest(
        name="x",
        network="dual",
        sensors=(SensorEntry("hdl64e", RangeImage()),),
        residual=Residual(),
        features=32,
        point_head=LITE,
        files={"image_net.onnx": FileEntry("0" * 64, 2_500_000, "float32")},
        weights={"trained": True},
        model={"network": "dual", "sensor": {}},
        parity={"head": {"max_abs": 1.25e-7}, "floats": []},
    )
    show_bundle(Bundle(Path("x"), manifest))
    shown = capsys.readouterr().out
    for text in (
        "64 x 2048",
        "down 64 128",
        "2.50 MB",
        "head max abs 1.25e-07",
        "floats none",
        "trained yes",
        "not measured",
    ):
        assert text in shown


def test_info(capsys):
    assert main(["info", str(BUNDLE)]) == 0
    shown = capsys.readouterr().out
    for word in ("network", "sensor", "image_net.onnx", "weights", "licence", "MIT"):
        assert word in shown
