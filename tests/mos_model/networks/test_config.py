import json
import subprocess
import sys

import pytest

from mos_model.networks.config import NAMES, ModelConfig, differing_fields, named_config
from runtime.bundle.head_shape import FULL, LITE
from runtime.bundle.residual import Residual
from runtime.errors import SettingError
from runtime.sensors.range_image import RangeImage


@pytest.mark.parametrize("channels", [32, 16])
@pytest.mark.parametrize("name", NAMES)
def test_round_trip_through_json(name: str, channels: int) -> None:
    config = named_config(name, channels)
    assert ModelConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert json.loads(json.dumps(config.to_dict())) == config.to_dict()


def test_round_trip_of_everything_changed() -> None:
    config = named_config(
        "rt",
        channels=24,
        name="small",
        sensor=RangeImage(32, 1024, 10.0, -30.0),
        residual=Residual((1, 4), kind="signed"),
        point_head=LITE,
        rt_widths=(16, 32, 64),
    )
    assert ModelConfig.from_dict(config.to_dict()) == config


def test_rows_of_the_ablation_table() -> None:
    rows = {name: named_config(name) for name in NAMES}
    assert [(rows[r].pooling, rows[r].meta_kernel) for r in "bcde"] == [
        ("average", False),
        ("soft", False),
        ("average", True),
        ("soft", True),
    ]
    assert {row.network for row in rows.values()} == {"dual", "lmnet", "rt"}
    assert rows["lmnet"].pooling == "average"
    assert rows["v2"].point_head == FULL
    assert rows["v2-lite"].point_head == LITE
    assert rows["v1"].point_head is None
    assert ModelConfig() == rows["v1"]


def test_head_follows_channels_and_keeps_its_own() -> None:
    head = named_config("lmnet", channels=8, point_head=FULL).point_head
    assert head is not None
    assert (head.in_channels, head.down, head.up) == (8, FULL.down, FULL.up)


def test_input_channels_follow_the_residuals() -> None:
    assert named_config("v1").in_channels == 13
    assert named_config("v1", residual=Residual((1, 3))).in_channels == 7


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"channels": 3}, "channels must be an even"),
        ({"channels": 16.0}, "channels must be an even"),
        ({"channels": True}, "channels must be an even"),
        ({"channels": 0}, "channels must be an even"),
        ({"pooling": "max"}, "pooling must be one of average, soft"),
        ({"network": "unet"}, "network must be one of"),
        ({"network": "lmnet"}, "has no MetaKernel"),
        ({"rt_widths": (8, 16)}, "belong to network 'rt'"),
        ({"width": 3}, "unknown setting width"),
    ],
)
def test_settings_that_do_not_fit(changes: dict, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        named_config("v1", **changes)


def test_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(SettingError, match="v2-lite"):
        named_config("v3")


def test_head_must_fit_the_network() -> None:
    with pytest.raises(SettingError, match="set in_channels of the head to 16"):
        ModelConfig(channels=16, point_head=FULL)


@pytest.mark.parametrize("part", [None, "sensor", "residual", "point_head"])
def test_unknown_keys_are_named(part: str | None) -> None:
    values = named_config("v2").to_dict()
    (values if part is None else values[part])["colour"] = 1
    with pytest.raises(SettingError, match=f"{part or 'model'}: unknown setting colour"):
        ModelConfig.from_dict(values)


@pytest.mark.parametrize("values", [[], None, {"channels": "32"}, {"sensor": 3}, {"sensor": {"std": 5}}])
def test_wrong_types_raise_setting_errors(values: object) -> None:
    with pytest.raises(SettingError):
        ModelConfig.from_dict(values)


def test_missing_keys_take_defaults() -> None:
    assert ModelConfig.from_dict({"name": "v1"}) == ModelConfig()


def test_differences_name_the_fields() -> None:
    a = named_config("v1")
    b = named_config("v1", channels=16, sensor=RangeImage(width=1024), point_head=LITE)
    assert differing_fields(a, a) == []
    lines = differing_fields(a, b)
    assert lines[:2] == ["channels: 32 against 16", "sensor.width: 2048 against 1024"]
    assert lines[2].startswith("point_head: None against {")
    assert len(lines) == 3


def test_configuration_needs_no_torch() -> None:
    code = "import sys, mos_model.networks.config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
