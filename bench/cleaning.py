"""What is left of movers and of all else when a recording is cleaned: `python -m bench.cleaning --sequence SEQUENCE`.

Beside DUFOMap (`pip install dufomap`), a tool that cleans whole recordings by what rays went through.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bench.peers import DUFOMAP, dufomap, is_there
from bench.report import save, show
from runtime import MosRunner
from runtime.classes import MOVING, STATIC, to_classes
from runtime.cleaning.votes import VOXEL, RecordingVotes
from runtime.commands.clean import DELAY
from runtime.commands.handler import run_alone
from runtime.evaluation.confusion import Confusion
from runtime.predict import predict
from runtime.recordings.labels import read_prediction
from runtime.recordings.recording import Indexed
from runtime.recordings.registry import open_recording


def accuracies(recording: Indexed, left_out: Iterator[np.ndarray]) -> dict[str, float]:
    """Share of the static points that stay and of the dynamic ones that go, as DynamicMap's benchmark has them, %."""
    confusion = Confusion()
    for index, moving in enumerate(left_out):
        confusion.add(to_classes(recording.labels(index)), np.where(moving, MOVING, STATIC))
    matrix = confusion.matrix
    static, dynamic = (100 * float(matrix[one, one] / matrix[one].sum()) for one in (STATIC, MOVING))
    return {"static (SA)": static, "dynamic (DA)": dynamic, "mean": (static + dynamic) / 2}


def bench(
    sequences: Annotated[list[Path], typer.Option("--sequence", help="With poses and labels; may be repeated")],
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Accuracies of labels with a delay, of `mos clean`, and of DUFOMap, where it is installed."""
    runner = MosRunner(bundle, threads=threads, delay=DELAY)
    rows = {}
    for sequence in sequences:
        recording = open_recording(sequence)
        with tempfile.TemporaryDirectory() as folder:
            labels = predict(recording, runner, folder).folder
            found = (read_prediction(labels / f"{key}.label") for key in recording.keys)
            rows[f"{recording.name}: labels"] = accuracies(recording, (to_classes(one) == MOVING for one in found))
            votes = RecordingVotes(recording, labels)
            rows[f"{recording.name}: mos clean"] = accuracies(recording, (~keep for _, _, keep in votes.scans()))
        if is_there(DUFOMAP):
            scans = list(recording)
            points, poses = [scan.points for scan in scans], [scan.known_pose() for scan in scans]
            rows[f"{recording.name}: DUFOMap"] = accuracies(recording, dufomap(points, poses, threads))
    show("points that stay and go, %", rows)
    save(out, threads, {"bundle": runner.bundle.manifest.name, "voxel": VOXEL, "percent": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "cleaning"))
