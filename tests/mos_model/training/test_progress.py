"""What a run shows and records."""

import json

import pytest
import torch
from rich.console import Console

from mos_model.training import progress
from mos_model.training.losses import Loss
from mos_model.training.progress import Display
from runtime.evaluation.confusion import Confusion

LOSS = Loss(*(torch.tensor(value) for value in (1.5, 1.0, 0.5)))


def seen() -> Confusion:
    confusion = Confusion()
    confusion.add([2, 2, 1, 1], [2, 1, 1, 2])
    return confusion


def show(out, **options) -> None:
    with Display(out, log_every=2, **options) as display:
        display.start(0, 5)
        for step in range(1, 6):
            display.step(step, LOSS, 0.01, seen(), 4)
        display.validation(5, seen())
        display.note("done")


def test_lines_without_a_terminal(tmp_path, capsys):
    show(tmp_path)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines[:3]] == ["step 2/5", "step 4/5", "step 5/5"]
    assert "loss 1.5000" in lines[0]
    assert "train IoU 33.3" in lines[0]
    assert "validation: iou 33.3  precision 50.0  recall 50.0" in lines[3]


def test_a_live_line_in_a_terminal(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(progress, "Console", lambda: Console(force_terminal=True, width=120))
    show(tmp_path)
    text = capsys.readouterr().out
    assert "5/5" in text
    assert "done" in text


def test_records(tmp_path):
    show(tmp_path)
    show(tmp_path)  # a resumed run appends
    records = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [r["step"] for r in records] == [2, 4, 5, 5] * 2
    assert records[0]["loss"] == 1.5
    assert records[0]["learning_rate"] == 0.01
    assert records[3]["kind"] == "validation"
    assert records[3]["iou"] == pytest.approx(1 / 3)


def test_quiet(tmp_path, capsys):
    show(tmp_path, quiet=True)
    assert not capsys.readouterr().out
    assert not list(tmp_path.iterdir())
