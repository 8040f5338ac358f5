import pytest

from mos_model.networks.config import differences
from mos_model.networks.dual import DualConfig
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import FULL, LITE
from runtime.bundle.residual import Residual
from runtime.errors import SettingError
from runtime.sensors.range_image import RangeImage


def test_input_channels_follow_the_residuals() -> None:
    assert named_config("v1").in_channels == 13
    assert named_config("v1", residual=Residual((1, 3))).in_channels == 7


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("v1", {"channels": 3}, "channels must be an even"),
        ("v1", {"channels": 16.0}, "channels must be an even"),
        ("v1", {"channels": True}, "channels must be an even"),
        ("v1", {"channels": 0}, "channels must be an even"),
        ("v1", {"pooling": "max"}, "pooling must be one of average, soft"),
        ("lmnet", {"pooling": "max"}, "pooling must be one of average, soft"),
        ("rt", {"widths": ()}, "at least one stage"),
        ("rt", {"widths": (8, 0)}, "at least one stage"),
    ],
)
def test_settings_that_do_not_fit(name: str, changes: dict, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        named_config(name, **changes)


def test_head_must_fit_the_network() -> None:
    with pytest.raises(SettingError, match="set in_channels of the head to 16"):
        DualConfig(channels=16, point_head=FULL)


def test_differences_name_the_fields() -> None:
    a = named_config("v1")
    b = named_config("v1", channels=16, range_image=RangeImage(width=1024), point_head=LITE)
    assert differences(a, a) == []
    lines = differences(a, b)
    assert lines[:2] == ["channels: 32 against 16", "range_image.width: 2048 against 1024"]
    assert lines[2].startswith("point_head: None against {")
    assert len(lines) == 3
    assert differences(a, b, ignored=("range_image", "point_head")) == ["channels: 32 against 16"]


def test_differences_of_two_kinds() -> None:
    lines = differences(named_config("lmnet"), named_config("rt"), ignored=("name", "residual"))
    assert lines == [
        "kind: 'lmnet' against 'rt'",
        "pooling: 'average' against None",
        "widths: None against [16, 32, 64, 128]",
    ]
