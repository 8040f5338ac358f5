"""Damaged files of every kind, by seeded mutation of whole ones: `python -m bench.faults --inputs 100000`.

What is read must be read, or refused with a `MosError`, in time and in memory, and leave everything as it was. Each
kind has a process of its own, so that a crash or a hang is seen; the next one goes on behind it. Stopped, the same
command goes on with the kinds that its JSON file does not have yet.
"""

import json
import resource
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.damaged import ROOT, SHIPPED, Kind, checkpoint, labels, of_bundle, poses, scan, sensor
from bench.damaged_runs import bag, live, packets, recording, run, runner
from bench.mutations import mixed, of_bytes, of_checkpoint, of_head, of_json, of_npz, of_onnx, of_words
from bench.report import save, show
from runtime.commands.handler import run_alone

LONGEST, WAITING = 60, 1800  # s of the processor, or of the clock, that an input may take: it hangs
LARGEST = 1000  # MB more than all inputs before it
MOST = 20  # crashes of a kind, after which it is not gone on with
TEXT = mixed(of_bytes, of_words)
TOPICS = ("/points", "/odom", "/tf")

KINDS: dict[str, Kind] = {
    "manifest": Kind(lambda: of_bundle("manifest.json"), mixed(of_bytes, of_json, of_json)),
    "manifest of rt": Kind(lambda: of_bundle("manifest.json", SHIPPED), mixed(of_bytes, of_json, of_json), 3),
    "network": Kind(lambda: of_bundle("image_net.onnx"), mixed(of_bytes, of_onnx, of_onnx), 3),
    "network in integers": Kind(
        lambda: of_bundle("image_net_int8.onnx", SHIPPED), mixed(of_bytes, of_onnx, of_onnx), 1
    ),
    "weights": Kind(lambda: of_bundle("point_head.npz"), mixed(of_bytes, of_npz, of_npz), 5),
    "checkpoint": Kind(checkpoint, mixed(of_bytes, of_checkpoint, of_checkpoint), 2),
    "sensor": Kind(sensor, mixed(of_bytes, of_json)),
    **{f"poses, {name}": Kind(lambda name=name: poses(name), TEXT) for name in ("kitti", "tum", "table")},
    "labels": Kind(labels),
    "scan .bin": Kind(lambda: scan(".bin")),
    "scan .npy": Kind(lambda: scan(".npy"), mixed(of_bytes, of_head)),
    **{
        f"scan {suffix} {encoding}": Kind(
            lambda suffix=suffix, encoding=encoding: scan(suffix, encoding), mixed(of_bytes, of_head, of_words)
        )
        for suffix, encodings in (
            (".pcd", ("ascii", "binary", "binary_compressed")),
            (".ply", ("ascii", "binary_little_endian", "binary_big_endian")),
        )
        for encoding in encodings
    },
    **{
        f"scan {suffix}": Kind(lambda suffix=suffix: scan(suffix), mixed(of_bytes, of_head))
        for suffix in (".las", ".laz", ".feather")
    },
    **{
        f"sequence, {name}": Kind(lambda name=name: recording(name), TEXT, 3)
        for name in ("poses.txt", "calib.txt", "times.txt")
    },
    **{
        f"bag, {kind}": Kind(lambda kind=kind: bag(kind), mixed(of_bytes, of_head), 3)
        for kind in ("bag", "db3", "mcap")
    },
    "packets of a Velodyne": Kind(packets, mixed(of_bytes, of_head), 3),
    **{f"live, {topic}": Kind(lambda topic=topic: live(topic), mixed(of_bytes, of_head), 3) for topic in TOPICS},
    "runner": Kind(runner, of_bytes, 1),
    "run, scan": Kind(lambda: run("sequences/00/velodyne/000001.bin"), of_bytes, 1),
    "run, poses": Kind(lambda: run("sequences/00/poses.txt"), TEXT, 1),
    "run, its note": Kind(lambda: run("out/sequences/00/run.json"), mixed(of_bytes, of_json), 1),
    "run, its journal": Kind(lambda: run("out/sequences/00/scans.jsonl"), TEXT, 1),
}


def try_kind(
    kind: str,
    seed: int,
    inputs: range,
    say: Callable[[dict[str, Any]], object],
    limits: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> None:
    """Say each input's number, what is neither read nor refused, and at the end how many were refused.

    limits: of an input.
    """
    from runtime.errors import MosError

    refused, (target, mutate, _) = 0, KINDS[kind]
    for path, data, read in target():
        path.write_bytes(data)
        read(path)  # what the whole one needs is no growth
        most = memory_mb()
        for number in inputs:
            say({"number": number, "refused": refused})
            path.write_bytes(mutate(data, np.random.default_rng((seed, number))))
            reason = None
            try:
                with limits():
                    read(path)
            except MosError:
                refused += 1
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
            if (now := memory_mb()) - most > LARGEST:
                reason = f"takes {now - most:.0f} MB"
            most = max(most, now)
            if reason:
                say({"failed": reason[:200], "of": number})
    say({"number": inputs.stop, "refused": refused})


@contextmanager
def ended_if_late() -> Iterator[None]:
    """By a signal, this process, if the block takes too long: not to be used in one that does anything else."""
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    signal.alarm(WAITING)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)


def memory_mb() -> float:
    """Most resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def try_all(kind: str, seed: int, count: int) -> tuple[int, list[dict[str, Any]]]:
    """Refused inputs, and what failed, of a kind: process after process, as long as one ends too early."""
    refused, failed, first = 0, [], 0
    while first < count and len(failed) < MOST:
        command = [sys.executable, "-m", "bench.faults", "--alone", "--kind", kind, "--seed", str(seed)]
        command += ["--first", str(first), "--inputs", str(count)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        failed += [line for line in lines if "failed" in line]
        last = next((line for line in reversed(lines) if "number" in line), {"number": first, "refused": 0})
        refused += last["refused"]
        if (number := last["number"]) == count:
            break
        late = done.returncode in (-signal.SIGALRM, -signal.SIGPROF)
        end = "hangs" if late else f"ends with {done.returncode}: {done.stderr.strip()[-120:]}"
        failed.append({"failed": end, "of": number})
        first = number + 1
    return refused, failed


def bench(
    seed: int = 0,
    inputs: Annotated[int, typer.Option(help="Of all kinds together, by their shares")] = 2000,
    kind: Annotated[list[str] | None, typer.Option(help="Only this kind; may be repeated")] = None,
    first: Annotated[int, typer.Option(hidden=True)] = 0,
    alone: Annotated[bool, typer.Option(hidden=True)] = False,
    out: Annotated[Path | None, typer.Option(help="JSON file, to which kinds are added")] = None,
) -> None:
    """Read damaged files of every kind, and count those that are neither read nor refused."""
    names = kind or list(KINDS)
    if alone:
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", RuntimeWarning)  # of arithmetic that nobody thought of
        (only,) = names
        return try_kind(only, seed, range(first, inputs), lambda line: typer.echo(json.dumps(line)), ended_if_late)
    total = sum(KINDS[name].share for name in names)
    rows = _known(out, seed)
    for name in names:
        began, count = time.perf_counter(), -(-inputs * KINDS[name].share // total)
        if rows.get(name, {}).get("inputs", 0) >= count:
            continue
        refused, failed = try_all(name, seed, count)
        rows[name] = {"inputs": count, "refused": refused, "failures": len(failed)}
        rows[name]["which"] = [f"number {line['of']}: {line['failed']}" for line in failed]
        typer.echo(f"{name}: {rows[name]}, {time.perf_counter() - began:.0f} s")
        save(out, 1, {"seed": seed, "kinds": rows})
    whole = {key: sum(row[key] for row in rows.values()) for key in ("inputs", "refused", "failures")}
    show("damaged files", {**rows, "all": whole})
    save(out, 1, {"seed": seed, "kinds": rows, "all": whole})
    raise typer.Exit(1 if whole["failures"] else 0)


def _known(out: Path | None, seed: int) -> dict[str, dict[str, Any]]:
    """What an earlier call wrote there of the same seed."""
    if out is None or not out.exists():
        return {}
    found = json.loads(out.read_text())
    return dict(found["kinds"]) if found["seed"] == seed else {}


if __name__ == "__main__":
    sys.exit(run_alone(bench, "faults"))
