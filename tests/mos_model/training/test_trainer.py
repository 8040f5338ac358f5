"""Training learns, resumes bit for bit, stops on what is not finite, for every network and both stages."""

import json
import math
import os
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from mos_model.networks import checkpoint
from mos_model.networks.registry import names
from mos_model.training.distributed import Ranks, join_ranks
from mos_model.training.progress import Display
from mos_model.training.recipe import TrainConfig, recipe
from mos_model.training.tasks import ImageTask, PointTask
from mos_model.training.trainer import Limits, Trainer, choose_precision
from mos_model.training.validation import Validation, evaluate_task
from runtime.errors import OutputError, TrainingError
from runtime.evaluation.confusion import Confusion
from tests.support.disk import full_disk
from tests.support.training import Patches, tiny_model

CPU = Ranks(torch.device("cpu"))
WEIGHTS = torch.tensor([0.0, 1.0, 3.0])
BASE = recipe("sim2real", steps=6, batch=4, crop=0, mix=2, warmup=2, learning_rate=0.01, validate_every=3)


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Threads cost more than they bring to networks of this size."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def make_trainer(out: Path, config: TrainConfig = BASE, source: Patches | None = None, ranks=CPU, **model) -> Trainer:
    """A trainer of a tiny network on patches."""
    torch.manual_seed(0)
    task = ImageTask(tiny_model(**model), WEIGHTS, ranks.device)
    validation = Validation(Patches(seed=99), 2)
    return Trainer(task, config, source or Patches(), validation, out, ranks=ranks, workers=0)


def run(trainer: Trainer, limits: Limits | None = None) -> float:
    with Display(trainer.out, quiet=trainer.ranks.rank > 0) as display:
        return trainer.run(limits or Limits(), display)


def equal_states(a: dict, b: dict) -> bool:
    """Whether two nested states hold the same bits."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(equal_states(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(equal_states, a, b))
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b


def test_it_learns_a_scene(tmp_path):
    source = Patches(group_size=1, height=32, width=128)

    class Scene:
        group_size = 1

        def group(self, number):
            return source.group(0)

    config = replace(BASE, steps=80, batch=1, ema=0.0, validate_every=1000)
    trainer = make_trainer(tmp_path, config, Scene(), channels=8)
    before = evaluate_task(trainer.task, Validation(source, 1), CPU).iou
    run(trainer)
    after = evaluate_task(trainer.task, Validation(source, 1), CPU).iou
    assert before < 0.5
    assert after > 0.9


def test_short_pieces_equal_an_uninterrupted_run_bit_for_bit(tmp_path):
    for name in ("whole", "pieces"):
        (tmp_path / name).mkdir()
    config = replace(BASE, mix=4)  # a block is 4 batches: most pieces begin within one
    run(make_trainer(tmp_path / "whole", config))
    run(make_trainer(tmp_path / "pieces", config), Limits(minutes=0))
    for step in range(1, 6):
        torch.manual_seed(12345)  # nothing of the process may matter
        trainer = make_trainer(tmp_path / "pieces", config)
        with torch.no_grad():
            for parameter in trainer.task.trained.parameters():
                parameter.add_(1)
        trainer.resume(checkpoint.read(tmp_path / "pieces" / "last.pt").training)
        assert trainer.step == step
        run(trainer, Limits(minutes=0))
    whole, pieces = (checkpoint.read(tmp_path / name / "last.pt") for name in ("whole", "pieces"))
    assert whole.training["step"] == 6
    assert equal_states(whole.image_net, pieces.image_net)
    assert equal_states(whole.training, pieces.training)


def first_batches(trainer: Trainer, count: int) -> list:
    """What `run` would train on first."""
    from mos_model.data.stream import Stream

    with Stream(trainer.source, trainer.config.batch, seed=trainer.config.seed, mix=trainer.config.mix, workers=0) as s:
        return [batch for batch, _ in zip(s, range(count), strict=False)]


def test_dropout_depends_on_the_step_alone(tmp_path):
    losses = []
    for noise in range(2):
        trainer = make_trainer(tmp_path, name="lmnet")
        torch.manual_seed(noise)
        losses.append(trainer.take_step(first_batches(trainer, 1)[0], Confusion()).total.item())
    assert losses[0] == losses[1]


def test_checkpoints_hold_averaged_weights_and_the_best_is_kept(tmp_path):
    trainer = make_trainer(tmp_path)
    best = run(trainer)
    loaded = checkpoint.load(tmp_path / "last.pt")
    assert equal_states(dict(loaded.image_net.state_dict()), trainer.average.state)
    assert not equal_states(dict(trainer.task.trained.state_dict()), trainer.average.state)
    training = checkpoint.load(tmp_path / "best.pt").training
    assert training["best"] == best
    assert "resume" not in training
    assert training["step"] in (3, 6)
    records = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [(r["kind"], r["step"]) for r in records if r["kind"] == "validation"] == [
        ("validation", 3),
        ("validation", 6),
    ]
    assert max(r["iou"] for r in records if r["kind"] == "validation") == best
    assert {"loss", "learning_rate", "samples_per_second"} <= records[-2].keys()


def test_a_loss_that_is_not_finite_stops_and_keeps_the_last_good_checkpoint(tmp_path):
    config = replace(BASE, mix=1, batch=4, validate_every=2)
    trainer = make_trainer(tmp_path, config, Patches(broken_from=3))
    with pytest.raises(TrainingError, match=r"step 3: the loss is nan"):
        run(trainer)
    kept = checkpoint.load(tmp_path / "last.pt")
    assert kept.training["step"] == 2
    assert all(value.isfinite().all() for value in kept.image_net.state_dict().values())


def test_a_full_disk_leaves_the_old_checkpoint(tmp_path):
    trainer = make_trainer(tmp_path)
    trainer.save("last.pt", whole=True)
    before = (tmp_path / "last.pt").read_bytes()
    with full_disk(len(before) - 1), pytest.raises(OutputError, match=r"last\.pt"):
        trainer.save("last.pt", whole=True)
    assert (tmp_path / "last.pt").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["last.pt"]


def shown_to(model, sample):
    """A patch as a network sees it: an image, or the list of its points."""
    if model.view.cylinder is None:
        return sample
    channels = model.view.shape[0]
    image = sample.image[:channels].reshape(channels, 1, -1)
    return sample._replace(image=image, labels=sample.labels.reshape(1, -1))


@pytest.mark.parametrize("name", names())
def test_every_configuration_trains(name, tmp_path):
    trainer = make_trainer(tmp_path, replace(BASE, batch=2), name=name)
    loss = trainer.take_step([shown_to(tiny_model(name), sample) for sample in Patches().group(0)[:2]], Confusion())
    assert math.isfinite(loss.total.item())
    trainer.save("last.pt", whole=True)
    assert checkpoint.load(tmp_path / "last.pt").config.name == name


@pytest.mark.parametrize("optimizer", ["sgd", "adam", "adamw"])
def test_optimizers(optimizer, tmp_path):
    trainer = make_trainer(tmp_path, replace(BASE, optimizer=optimizer))
    before = [p.clone() for p in trainer.task.trained.parameters()]
    trainer.take_step(Patches().group(0), Confusion())
    rate = BASE.learning_rate_at(0)
    assert all(group["lr"] == rate for group in trainer.optimizer.param_groups)
    assert any(not torch.equal(a, b) for a, b in zip(before, trainer.task.trained.parameters(), strict=True))


def test_second_stage_trains_the_head_and_leaves_the_image_network(tmp_path):
    model = tiny_model("v2-lite", 4)
    image_task = ImageTask(model, WEIGHTS, CPU.device)
    image_net = image_task.trained
    frozen = {key: value.clone() for key, value in image_net.state_dict().items()}
    config = recipe("paper", stage=2, epoch_steps=10, steps=3, validate_every=3)
    task = PointTask(model, image_net, WEIGHTS, CPU.device)
    head = {key: value.clone() for key, value in task.head.state_dict().items()}
    trainer = Trainer(
        task, config, Patches(points=200), Validation(Patches(points=200), 1), tmp_path, ranks=CPU, workers=0
    )
    assert math.isfinite(run(trainer))
    loaded = checkpoint.load(tmp_path / "last.pt")
    assert equal_states(frozen, dict(loaded.image_net.state_dict()))
    assert equal_states(dict(task.head.state_dict()), dict(loaded.point_head.state_dict()))
    changed = [not torch.equal(head[key], value) for key, value in loaded.point_head.state_dict().items()]
    assert sum(changed) > 0.9 * len(changed)
    assert loaded.config.point_head is not None


def test_points_of_a_batch_are_those_of_its_scans():
    """Two scans in one batch give the logits that they give one by one."""
    model = tiny_model("v2-lite", 4)
    task = PointTask(model, ImageTask(model, WEIGHTS, CPU.device).trained, WEIGHTS, CPU.device)
    task.trained.eval()
    samples = Patches(points=100).group(0)[:2]
    with torch.no_grad():
        together, labels = task.forward(task.trained, samples)
        alone = torch.cat([task.forward(task.trained, [sample])[0] for sample in samples])
    assert torch.allclose(together, alone, atol=1e-4)
    assert np.array_equal(labels.numpy(), np.concatenate([s.classes for s in samples]))


def test_bfloat16_step(tmp_path):
    trainer = make_trainer(tmp_path, replace(BASE, precision="bf16"))
    plain = make_trainer(tmp_path, replace(BASE, precision="fp32"))
    batch = Patches().group(0)
    low, full = (t.take_step(batch, Confusion()).total.item() for t in (trainer, plain))
    assert low != full
    assert low == pytest.approx(full, rel=0.05)
    assert next(trainer.task.trained.parameters()).dtype == torch.float32


def test_precision():
    assert choose_precision("fp16", torch.device("cpu")) == torch.float16
    assert choose_precision("auto", torch.device("cpu")) in (torch.float32, torch.bfloat16)


def test_validation_counts_every_sample_once():
    source = Patches(seed=5)
    task = ImageTask(tiny_model(), WEIGHTS, CPU.device)
    for keep in (False, True):
        validation = Validation(source, 5, keep)
        for _ in range(2):
            confusion = evaluate_task(task, validation, CPU)
            assert confusion.matrix.sum() == 5 * source.group_size * source.height * source.width


def train_one_of_two(rank: int, port: int, out: str) -> None:
    """A process of `test_two_processes`."""
    torch.set_num_threads(1)
    os.environ.update(
        MASTER_ADDR="127.0.0.1", MASTER_PORT=str(port), RANK=str(rank), LOCAL_RANK=str(rank), WORLD_SIZE="2"
    )
    ranks = join_ranks("cpu")
    trainer = make_trainer(Path(out), replace(BASE, steps=4), ranks=ranks)
    run(trainer)
    weights = torch.cat([p.detach().reshape(-1) for p in trainer.task.trained.parameters()])
    torch.save({"weights": weights, "best": trainer.best}, Path(out) / f"rank{rank}.pt")
    ranks.close()


def test_two_processes(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    torch.multiprocessing.spawn(train_one_of_two, (port, str(tmp_path)), nprocs=2)
    first, second = (torch.load(tmp_path / f"rank{rank}.pt", weights_only=True) for rank in range(2))
    assert torch.equal(first["weights"], second["weights"])
    assert first["best"] == second["best"] >= 0  # -inf: not validated
    assert checkpoint.load(tmp_path / "last.pt").training["world"] == 2
    alone = tmp_path / "alone"
    alone.mkdir()
    trainer = make_trainer(alone, replace(BASE, steps=4))
    run(trainer)
    weights = torch.cat([p.detach().reshape(-1) for p in trainer.task.trained.parameters()])
    assert not torch.equal(first["weights"], weights)  # the second process's samples counted
