"""Checkpoints and configurations of format 1 load for ever."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from export.checkpoint.key_map import head_modules, image_modules, published_names
from mos_model.networks import checkpoint
from mos_model.networks.config import ModelConfig
from mos_model.networks.registry import named_config, names, read_config
from mos_model.training.distributed import Ranks
from mos_model.training.recipe import recipe
from mos_model.training.tasks import ImageTask, PointTask, Task
from mos_model.training.trainer import Trainer
from runtime.bundle.head_shape import PointHeadConfig
from runtime.errors import CheckpointError, SettingError
from runtime.evaluation.confusion import Confusion
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import SENSORS
from tests.support.make_tiny import random_network, tiny_config
from tests.support.paths import TINY
from tests.support.training import IMAGE, Patches

HEADS = [
    PointHeadConfig(in_channels=4, down=(4, 6, 8, 10), up=(10, 8, 6, 6)),
    PointHeadConfig(in_channels=4, down=(6, 8), up=(6, 6), fuse_after_up=None),
]


def flat(config: ModelConfig) -> dict:
    """The configuration as format 1 had it."""
    values = {"pooling": "average", "meta_kernel": False, "widths": [], **config.to_dict()}
    values["sensor"] = values.pop("range_image")
    return {**values, "network": values.pop("kind"), "rt_widths": values.pop("widths")}


def in_format_1(path: Path) -> None:
    """Rewrite a checkpoint of today: the networks of the paper and point heads had the published names."""
    config = read_config(torch.load(path, weights_only=True)["config"])
    image = {} if config.kind == "rt" else image_modules(config.kind)
    head = {} if config.point_head is None else head_modules(config.point_head)

    def before(state: dict, modules: dict[str, str]) -> dict:
        names = published_names(state, modules) if modules else {key: key for key in state}
        return {names[key]: value for key, value in state.items()}

    content = torch.load(path, weights_only=True)
    content |= {"format": 1, "config": flat(config), "image_net": before(content["image_net"], image)}
    if head:
        content["point_head"] = before(content["point_head"], head)
    resume = content["training"].get("resume", {})
    for key in {"module", "average"} & resume.keys():
        resume[key] = before(resume[key], head or image)
    torch.save(content, path)


def same(module: torch.nn.Module | None, other: torch.nn.Module | None) -> bool:
    """Whether two modules, or none, hold the same bits."""
    if module is None or other is None:
        return module is other
    one, two = module.state_dict(), other.state_dict()
    return one.keys() == two.keys() and all(torch.equal(one[key], two[key]) for key in one)


@pytest.mark.parametrize("name", ["lmnet", "b", "c", "d", "v1", "rt"])
@pytest.mark.parametrize("head", [None, *HEADS], ids=["no head", "full", "lite"])
def test_every_network(name: str, head: PointHeadConfig | None, tmp_path: Path) -> None:
    config = named_config(name, 4, point_head=head)
    image_net, point_head = random_network(config)
    checkpoint.save(tmp_path / "a.pt", config, image_net, point_head, {"step": 3})
    in_format_1(tmp_path / "a.pt")
    found = checkpoint.load(tmp_path / "a.pt")
    assert found.config == config
    assert found.training == {"step": 3}
    assert same(found.image_net, image_net)
    assert same(found.point_head, point_head)


def test_committed_checkpoint() -> None:
    """It was written in format 1; its weights are compared in `tests/export/test_convert.py`."""
    assert checkpoint.load(TINY / "checkpoint.pt").config == tiny_config()


@pytest.mark.parametrize("stage", [1, 2])
def test_an_interrupted_run_goes_on(stage: int, tmp_path: Path) -> None:
    config = named_config("lmnet", 4, range_image=IMAGE, point_head=HEADS[1] if stage == 2 else None)
    trainers = []
    for _ in range(2):
        torch.manual_seed(len(trainers))  # the second begins with other weights
        weights, device = torch.ones(3), torch.device("cpu")
        if stage == 1:
            task: Task = ImageTask(config, weights, device)
        else:
            task = PointTask(config, config.build_image_network(), weights, device)
        settings = recipe("sim2real", stage, steps=4, batch=1, crop=0, mix=1)
        source = Patches(points=200 if stage == 2 else 0)
        trainers.append(Trainer(task, settings, source, None, tmp_path, ranks=Ranks(device), workers=0))
    first, second = trainers
    batch = first.source.group(0)[:2]
    first.take_step(batch, Confusion())
    first.save("last.pt", whole=True)
    in_format_1(tmp_path / "last.pt")
    second.resume(checkpoint.read(tmp_path / "last.pt").training)
    assert second.step == 1
    assert same(second.task.trained, first.task.trained)
    if stage == 1:
        for trainer in trainers:
            trainer.take_step(batch, Confusion())
        assert same(second.task.trained, first.task.trained)


@pytest.mark.parametrize("change", ["missing", "extra", "swapped"])
def test_tensors_of_another_network(change: str, tmp_path: Path) -> None:
    config = named_config("lmnet", 4)
    checkpoint.save(tmp_path / "a.pt", config, config.build_image_network())
    in_format_1(tmp_path / "a.pt")
    content = torch.load(tmp_path / "a.pt", weights_only=True)
    state = content["image_net"]
    keys = list(state)
    if change == "missing":
        del state[keys[7]]
    elif change == "extra":
        state["more.weight"] = torch.ones(1)
    else:
        content["image_net"] = {key: state[key] for key in (keys[1], keys[0], *keys[2:])}
    torch.save(content, tmp_path / "a.pt")
    with pytest.raises(CheckpointError, match="image network: its tensors are not those of the network"):
        checkpoint.load(tmp_path / "a.pt")


def test_flat_configurations() -> None:
    for name in [name for name in names() if name not in ("limoseg", "cylinder3d")]:  # which came later
        config = named_config(name, 16)
        assert read_config(flat(config)) == config
    assert read_config(flat(named_config("rt", widths=(8, 16)))) == named_config("rt", widths=(8, 16))
    assert read_config(flat(named_config("rt")) | {"pooling": "soft"}) == named_config("rt")  # had no meaning


def test_the_sensor_is_that_whose_range_image_it_was() -> None:
    """Whatever its rows and columns; one of no known sensor was simulated as an HDL-64E."""
    vlp16 = SENSORS["vlp16"].range_image
    for image, name in ((vlp16, "vlp16"), (replace(vlp16, width=64), "vlp16"), (RangeImage(fov_up=90), "hdl64e")):
        config = named_config("rt", sensor=name, range_image=image)
        assert read_config(flat(config)) == config


@pytest.mark.parametrize(
    ("name", "changes", "expected"),
    [
        ("rt", {"rt_widths": [8, 16]}, named_config("rt", widths=(8, 16))),
        ("v1", {"network": "lmnet", "meta_kernel": False}, named_config("lmnet", name="v1", pooling="soft")),
        ("v1", {"pooling": "average"}, named_config("d", name="v1")),
        ("lmnet", {"meta_kernel": False}, named_config("lmnet")),
        ("rt", {"sensor": {"width": 64}}, named_config("rt", range_image=RangeImage(width=64))),
    ],
)
def test_names_of_then_may_be_set(name: str, changes: dict, expected: ModelConfig) -> None:
    """As `mos train --set model.NAME=VALUE` does."""
    assert read_config(named_config(name).to_dict() | changes) == expected


@pytest.mark.parametrize(
    ("name", "changes"), [("lmnet", {"meta_kernel": True}), ("v1", {"rt_widths": [8]}), ("rt", {"pooling": "soft"})]
)
def test_settings_of_other_networks_are_refused(name: str, changes: dict) -> None:
    with pytest.raises(SettingError, match="unknown entry"):
        read_config(named_config(name).to_dict() | changes)
