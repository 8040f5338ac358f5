import os
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from mos_model.networks import checkpoint
from mos_model.networks.config import ModelConfig
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import PointHeadConfig
from runtime.errors import CheckpointError, OutputError
from runtime.sensors.registry import SENSORS
from tests.support.disk import full_disk
from tests.support.paths import ROOT

HEAD = PointHeadConfig(in_channels=2, down=(4,), up=(4,), fuse_after_up=None, dropout=0)
CONFIG = named_config("lmnet", channels=2, point_head=HEAD)


def modules(config: ModelConfig = CONFIG) -> tuple[torch.nn.Module, torch.nn.Module | None]:
    torch.manual_seed(1)
    return config.build_image_network(), config.build_point_head()


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    checkpoint.save(tmp_path / "a.pt", CONFIG, *modules(), training={"step": 3, "best": [0.5, None]})
    return tmp_path / "a.pt"


def altered(path: Path, **changes: object) -> Path:
    torch.save(torch.load(path, weights_only=True) | changes, path)
    return path


def test_round_trip(saved: Path) -> None:
    loaded = checkpoint.load(saved, CONFIG)
    assert loaded.config == CONFIG
    assert loaded.training == {"step": 3, "best": [0.5, None]}
    for module, original in zip((loaded.image_net, loaded.point_head), modules(), strict=True):
        assert module is not None
        assert not module.training
        for key, value in original.state_dict().items():
            assert torch.equal(module.state_dict()[key], value), key


def test_without_point_head(tmp_path: Path) -> None:
    config = named_config("v1", channels=2)
    checkpoint.save(tmp_path / "a.pt", config, *modules(config))
    assert checkpoint.load(tmp_path / "a.pt").point_head is None
    assert checkpoint.read(tmp_path / "a.pt").point_head is None


def test_half_precision(saved: Path, tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "half.pt", CONFIG, *modules(), half=True)
    assert (tmp_path / "half.pt").stat().st_size < 0.8 * saved.stat().st_size
    loaded = checkpoint.load(tmp_path / "half.pt")
    for key, value in modules()[0].state_dict().items():
        mine = loaded.image_net.state_dict()[key]
        assert mine.dtype == value.dtype
        assert torch.equal(mine, value.half().to(value.dtype)), key


def test_what_half_precision_cannot_hold_stays_whole(tmp_path: Path) -> None:
    image_net, head = modules()
    image_net.logits.bias.data[0] = 1e6
    checkpoint.save(tmp_path / "a.pt", CONFIG, image_net, head, half=True)
    stored = checkpoint.read(tmp_path / "a.pt").image_net
    assert [key for key, value in stored.items() if value.dtype == torch.float32] == ["logits.bias"]
    loaded = checkpoint.load(tmp_path / "a.pt").image_net.state_dict()
    assert torch.equal(loaded["logits.bias"], image_net.logits.bias.data)


def test_same_checkpoint_same_bytes(saved: Path, tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "b.pt", CONFIG, *modules(), training={"step": 3, "best": [0.5, None]})
    assert saved.read_bytes() == (tmp_path / "b.pt").read_bytes()


def test_old_checkpoint_survives_a_full_disk(saved: Path) -> None:
    before = saved.read_bytes()
    with full_disk(len(before) // 2), pytest.raises(OutputError, match="cannot write"):
        checkpoint.save(saved, CONFIG, *modules())
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


def test_place_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"file/a\.pt"):
        checkpoint.save(tmp_path / "file" / "a.pt", CONFIG, *modules())


def test_optimizer_state_may_be_stored(tmp_path: Path) -> None:
    image_net, head = modules()
    optimizer = torch.optim.AdamW(image_net.parameters())
    image_net(torch.randn(2, 13, 32, 32)).logits.sum().backward()
    optimizer.step()
    checkpoint.save(tmp_path / "a.pt", CONFIG, image_net, head, {"optimizer": optimizer.state_dict()})
    state = checkpoint.load(tmp_path / "a.pt").training["optimizer"]
    torch.optim.AdamW(image_net.parameters()).load_state_dict(state)


@pytest.mark.parametrize(
    ("training", "where"),
    [
        ({"iou": np.float64(0.5)}, r"training\.iou is a float64"),
        ({"a": [1, {"b": Path()}]}, r"training\.a\[1\]\.b is a PosixPath"),
    ],
)
def test_values_that_could_not_be_loaded_are_refused(tmp_path: Path, training: dict, where: str) -> None:
    with pytest.raises(CheckpointError, match=where):
        checkpoint.save(tmp_path / "a.pt", CONFIG, *modules(), training=training)


def test_head_must_fit_the_configuration(tmp_path: Path) -> None:
    image_net, head = modules()
    with pytest.raises(CheckpointError, match="has a point head"):
        checkpoint.save(tmp_path / "a.pt", CONFIG, image_net)
    with pytest.raises(CheckpointError, match="has no point head"):
        checkpoint.save(tmp_path / "a.pt", named_config("lmnet", channels=2), image_net, head)


def test_another_configuration_is_named(saved: Path) -> None:
    with pytest.raises(CheckpointError, match="channels: 2 against 4") as error:
        checkpoint.load(saved, named_config("lmnet", channels=4))
    assert "point_head" in str(error.value)
    assert "sensor" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04broken", pickle.dumps([1, 2], protocol=2)])
def test_file_that_is_no_checkpoint(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(CheckpointError, match=r"a\.pt: not a checkpoint"):
        checkpoint.load(tmp_path / "a.pt")


def test_truncated_file(saved: Path) -> None:
    saved.write_bytes(saved.read_bytes()[:-100])
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        checkpoint.load(saved)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no such checkpoint"):
        checkpoint.load(tmp_path / "a.pt")
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        checkpoint.load(tmp_path)


class Malicious:
    def __init__(self, folder: Path) -> None:
        self.folder = str(folder)

    def __reduce__(self) -> tuple:
        return os.mkdir, (self.folder,)


def test_nothing_is_executed(saved: Path, tmp_path: Path) -> None:
    altered(saved, training={"x": Malicious(tmp_path / "made")})
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        checkpoint.load(saved)
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 3}, "format 3, but this version reads formats 1 to 2"),
        ({"config": {"colour": 1}}, "unknown entry colour"),
        ({"config": 5}, "does not fit this version"),
        ({"point_head": {}}, r"point head does not fit the network: stem\.kernel is missing"),
        ({"image_net": [1]}, "expected a mapping"),
        ({"image_net": {5: torch.zeros(1)}}, "5 is not part of the network"),
        ({"training": [1]}, "its training is a list"),
        ({"training": {"resume": 3}, "format": 1}, "not those of the network|goes on from is a int"),
        ({"config": named_config("lmnet", channels=2).to_dict()}, "holds a point head that"),
    ],
)
def test_content_that_does_not_fit(saved: Path, changes: dict, message: str) -> None:
    with pytest.raises(CheckpointError, match=message):
        checkpoint.load(altered(saved, **changes))


def test_published_file_is_told_apart(tmp_path: Path) -> None:
    torch.save({"state_dict": {}}, tmp_path / "a.pt")
    with pytest.raises(CheckpointError, match="mos export"):
        checkpoint.load(tmp_path / "a.pt")


def test_load_state_names_every_key_and_leaves_the_module() -> None:
    module = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Linear(3, 4))
    before = {key: value.clone() for key, value in module.state_dict().items()}
    state = {
        "0.weight": torch.zeros(3, 5),
        "0.bias": torch.tensor([0.0, 1.0, float("nan")]),
        "1.weight": 7,
        "1.bias": torch.zeros(4, dtype=torch.complex64),
        "2.weight": torch.zeros(1),
    }
    with pytest.raises(CheckpointError) as error:
        checkpoint.load_state(module, state, "file.pt")
    for part in (
        "file.pt does not fit the network",
        "0.weight is (3, 5) instead of (3, 2)",
        "0.bias is not finite",
        "1.weight is no tensor",
        "1.bias is no tensor of plain numbers",
        "2.weight is not part of the network",
    ):
        assert part in str(error.value)
    assert all(torch.equal(value, before[key]) for key, value in module.state_dict().items())


@pytest.mark.parametrize("odd", [torch.zeros(2, 2).to_sparse(), torch.zeros(2, 2, device="meta")])
def test_tensors_of_no_plain_numbers(odd: torch.Tensor) -> None:
    module = torch.nn.Linear(2, 2)
    with pytest.raises(CheckpointError, match="weight is no tensor of plain numbers"):
        checkpoint.load_state(module, {"weight": odd}, "file.pt")


def test_load_state_under_other_names() -> None:
    module = torch.nn.Linear(1, 1)
    state = {"kernel": torch.ones(1, 1, dtype=torch.float16), "shift": torch.ones(1)}
    names = {"weight": "kernel", "bias": "shift"}
    checkpoint.load_state(module, state, "x", names)
    assert module.weight.dtype == torch.float32
    assert module.weight.item() == 1
    with pytest.raises(CheckpointError, match="shift is missing; offset is not part"):
        checkpoint.load_state(module, {"kernel": state["kernel"], "offset": torch.ones(1)}, "x", names)


def test_the_checkpoint_that_ships_is_for_all_sensors() -> None:
    shipped = checkpoint.load(ROOT / "models" / "rt" / "checkpoint.pt").config
    others = tuple(name for name in SENSORS if name != shipped.sensor)
    residual = replace(shipped.residual, min_range=1.0, max_range=100.0)
    assert shipped == replace(named_config("rt-head", 16), name="rt", other_sensors=others, residual=residual)
