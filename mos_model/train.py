"""`mos train`, `python -m mos_model.train`: from SemanticKITTI or simulated streets to a checkpoint."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from runtime.commands.handler import need_extra, run_alone
from runtime.commands.options import Frame, SensorName
from runtime.sensors.registry import DEFAULT_SENSOR, SENSORS, find_sensor


def train(
    out: Annotated[Path, typer.Option(help="Folder of the run: last.pt, best.pt, metrics.jsonl")] = Path("runs/train"),
    data: Annotated[str, typer.Option(help="'simulated', or the root of a data set (holds sequences/)")] = "simulated",
    road: Annotated[bool, typer.Option(help="With KITTI-Road-MOS in the same root")] = False,
    train_on: Annotated[str | None, typer.Option(help="Sequences, as 00,01 (default: the published split)")] = None,
    validate_on: Annotated[str | None, typer.Option(help="Sequences, as 08 (default: the published split)")] = None,
    frame: Frame = None,
    sensor: SensorName = DEFAULT_SENSOR,
    config: Annotated[str, typer.Option(help="Network by name: v1, rt, rt-head, ... (a wrong one lists all)")] = "v1",
    channels: Annotated[int, typer.Option(min=1, help="Width of the image network")] = 32,
    recipe: Annotated[str, typer.Option(help="'paper', 'sim2real' or 'any-sensor'")] = "paper",
    stage: Annotated[int, typer.Option(min=1, max=2, help="1: image network; 2: point head, image network frozen")] = 1,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps (default: of the recipe)")] = None,
    batch: Annotated[
        int | None, typer.Option(min=1, help="Samples a step and process (default: of the recipe)")
    ] = None,
    crop: Annotated[
        int | None, typer.Option(min=0, help="Columns of each sample, 0: all (default: of the recipe)")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, data and dropout")] = 0,
    init: Annotated[Path | None, typer.Option(help="Checkpoint whose weights are the start")] = None,
    init_head: Annotated[Path | None, typer.Option(help="Checkpoint whose point head is the start (stage 2)")] = None,
    resume: Annotated[bool, typer.Option(help="Go on from last.pt in the folder of the run")] = False,
    precision: Annotated[str | None, typer.Option(help="auto, fp32, bf16 or fp16")] = None,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1")] = "auto",
    threads: Annotated[int, typer.Option(min=0, help="CPU threads of the network, 0: as torch likes")] = 0,
    workers: Annotated[int, typer.Option(min=0, help="Processes that make samples")] = 1,
    minutes: Annotated[float, typer.Option(min=0, help="Stop (and save) after so long")] = float("inf"),
    save_every: Annotated[float, typer.Option(min=0, help="Minutes between checkpoints")] = 5.0,
    log_every: Annotated[int, typer.Option(min=1, help="Steps between lines")] = 20,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="Other settings: name=value of the recipe, augmentation.NAME, model.NAME"),
    ] = None,
) -> None:
    """Train a network on SemanticKITTI or on simulated streets (extra 'train')."""
    if data == "simulated" and (road or frame or train_on is not None or validate_on is not None):
        raise typer.BadParameter(
            "--road, --train-on, --validate-on and --pose-frame are for recordings, and --data is 'simulated'"
        )
    if road and train_on is not None and validate_on is not None:
        raise typer.BadParameter(
            "--road adds to the published split, of which --train-on and --validate-on leave nothing"
        )
    if resume and (init is not None or init_head is not None):
        raise typer.BadParameter("--resume goes on from last.pt, --init starts from other weights: give one of them")
    if init_head is not None and stage == 1:
        raise typer.BadParameter("--init-head is for stage 2, which trains the point head")
    others = dict(parse_setting(text) for text in set_ or [])
    need_extra("train", "torch")
    import torch

    from mos_model.networks.registry import named_config, read_config
    from mos_model.training.distributed import join_ranks
    from mos_model.training.recipe import recipe as named_recipe
    from mos_model.training.session import run_training
    from mos_model.training.sources import SIMULATED, Data
    from mos_model.training.trainer import Limits

    others_too = tuple(name for name in SENSORS if name != sensor) if recipe == "any-sensor" else ()
    image = find_sensor(sensor).range_image
    model = named_config(config, channels, sensor=sensor, other_sensors=others_too, range_image=image).to_dict()
    for name in [name for name in others if name.startswith("model.")]:
        set_nested(model, name.removeprefix("model.").split("."), others.pop(name))
    network = read_config(model)
    given = {"steps": steps, "batch": batch, "crop": crop, "precision": precision, "seed": seed}
    changes = {name: value for name, value in given.items() if value is not None} | others
    width = network.view.shape[2]
    if "crop" not in changes and named_recipe(recipe, stage).crop >= width:
        changes["crop"] = 16 * round(width / 64)  # a quarter, as the recipe's is of an HDL-64E's range image
    if threads:
        torch.set_num_threads(threads)
    ranks = join_ranks(device)
    try:
        run_training(
            network,
            lambda epoch_steps: named_recipe(recipe, stage, epoch_steps, **changes),
            SIMULATED if data == "simulated" else Data(Path(data), *choose_split(road, train_on, validate_on), frame),
            out,
            init=init,
            init_head=init_head,
            resume=resume,
            ranks=ranks,
            workers=workers,
            limits=Limits(minutes, save_every),
            log_every=log_every,
        )
    finally:
        ranks.close()


def set_nested(settings: dict[str, Any], path: list[str], value: Any) -> None:
    """Set settings[path[0]][path[1]]...; unknown keys are left to the configuration to refuse."""
    if path[0] == "sensor" and len(path) > 1:  # what the range image was called
        path = ["range_image", *path[1:]]
    *outer, last = path
    for name in outer:
        if not isinstance(settings.get(name), dict):
            raise typer.BadParameter(f"--set model.{'.'.join(path)}: {name!r} is no group of settings")
        settings = settings[name]
    settings[last] = value


def choose_split(road: bool, train_on: str | None, validate_on: str | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the training and validation sequences: the published ones where none are given."""
    from mos_model.data import kitti

    train: tuple[str, ...] = kitti.TRAIN + kitti.ROAD_TRAIN if road else kitti.TRAIN
    validation: tuple[str, ...] = kitti.VALIDATION + kitti.ROAD_VALIDATION if road else kitti.VALIDATION
    if train_on is not None:
        train = names_of(train_on)
    if validate_on is not None:
        validation = names_of(validate_on) if validate_on else ()
    return train, validation


def names_of(text: str) -> tuple[str, ...]:
    """("00", "01") of "00,01"."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise typer.BadParameter(f"{text!r} is no list of sequences, such as 00,01")
    return names


def parse_setting(text: str) -> tuple[str, Any]:
    """("augmentation.yaw", 20) of "augmentation.yaw=20"; the value is JSON, or else a word."""
    name, equals, value = text.partition("=")
    if not equals:
        raise typer.BadParameter(f"--set takes name=value, not {text!r}")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


if __name__ == "__main__":
    sys.exit(run_alone(train, "mos train"))
