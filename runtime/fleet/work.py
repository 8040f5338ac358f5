"""Many recordings to label: what is to be done with each, what is heard of it, and what became of it."""

import socket
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from runtime import __version__
from runtime.bundle.loading import load_bundle, sha256_of
from runtime.bundle.manifest import MANIFEST
from runtime.compute.sessions import provider_name
from runtime.errors import BundleError, MosError, is_interrupt
from runtime.fleet.labelling import label
from runtime.fleet.voice import Progress, heard
from runtime.fleet.wanted import Wanted
from runtime.image.precision import choose_precision
from runtime.recordings.extrinsics import read_extrinsics
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.recordings.searching import name_of
from runtime.runner import MosRunner
from runtime.settings import RunnerSettings


@dataclass(frozen=True)
class Work:
    """The same for all recordings, in whatever process of whatever machine; `settle` makes it."""

    bundle: Path | None  # None: the one that is installed
    manifest_sha256: str  # of the bundle
    settings: RunnerSettings
    options: Options
    out: Path
    overwrite: bool
    wanted: Wanted
    version: str = __version__  # of this package

    def runner(self) -> MosRunner:
        """Raises BundleError where this machine has another bundle or version, and what `MosRunner` does."""
        runner = MosRunner(self.bundle, settings=self.settings)
        here = __version__, sha256_of(runner.bundle.path / MANIFEST)
        if here != (self.version, self.manifest_sha256):
            raise BundleError(
                f"{socket.gethostname()} has another version or bundle than the others: lidar-mos {here[0]} with "
                f"{runner.bundle.path}, manifest {here[1][:12]}, not {self.version} with {self.manifest_sha256[:12]}. "
                f"Install the same, or name a bundle that all machines see (`bundle`)"
            )
        return runner


@dataclass(frozen=True)
class Said:
    """Something that a user should know of a recording."""

    name: str
    text: str
    warning: bool = False


@dataclass(frozen=True)
class Scans:
    """How far a recording is."""

    name: str
    done: int
    total: int | None  # None: that is not known


@dataclass(frozen=True)
class Done:
    """What became of a recording."""

    name: str
    error: str = ""  # why it is not labelled; "": it is
    scans: int = 0  # that were labelled
    resumed: int = 0  # that had their labels
    points: int = 0  # of those that were labelled
    moving: int = 0
    warnings: int = 0
    seconds: float = 0.0
    host: str = ""


Event = Said | Scans | Done
Hear = Callable[[Event], object]


class Way(Protocol):
    """How the recordings at some paths are labelled: one after the other, in processes, on other machines."""

    def __call__(self, work: Work, paths: Sequence[Path], *, hear: Hear) -> None:
        """`hear` is told of each recording, `Done` last. Raises what stops all of them."""


def settle(
    bundle: Path | None, settings: RunnerSettings, options: Options, out: Path, overwrite: bool, wanted: Wanted
) -> Work:
    """Decide here what would be decided by each machine: sensor file, precision of the network, where files lie.

    Raises BundleError, and SettingError or PoseError of extrinsics.
    """
    loaded = load_bundle(bundle)
    precision, _ = choose_precision(
        loaded, settings.precision, [provider_name(one) for one in settings.providers or ()]
    )
    given: dict[str, Any] = {name: path.absolute() for name in ("poses", "calib") if (path := getattr(options, name))}
    if options.extrinsics:
        given["extrinsics"] = " ".join(repr(float(one)) for one in read_extrinsics(options.extrinsics).ravel())
    return Work(
        None if bundle is None else bundle.absolute(),
        sha256_of(loaded.path / MANIFEST),
        replace(settings, precision=precision, sensor=settings.profile),
        replace(options, **given),
        out.absolute(),
        overwrite,
        wanted,
    )


def do(work: Work, runner: MosRunner, path: Path, hear: Hear) -> Done:
    """Label the recording at a path. What is wrong with it is in the answer: it stops no other."""
    begun, voice = time.perf_counter(), Telling(name_of(path), hear)
    try:
        with heard(voice):
            recording = open_recording(path, work.options)
            summary = label(recording, runner, work.options, work.out, work.overwrite, work.wanted, voice)
        done = Done(voice.name, "", summary.scans, summary.resumed, summary.points, summary.moving)
    except Exception as error:
        if is_interrupt(error):
            raise
        expected = isinstance(error, MosError | OSError)
        done = Done(voice.name, str(error) if expected else traceback.format_exc().rstrip())
    seconds = time.perf_counter() - begun
    return replace(done, warnings=voice.warnings, seconds=seconds, host=socket.gethostname())


class Telling:
    """The `Voice` of a recording among others."""

    def __init__(self, name: str, hear: Hear) -> None:
        self.name, self.warnings, self._hear = name, 0, hear

    def say(self, text: str) -> None:
        self._hear(Said(self.name, text))

    def warn(self, text: str) -> None:
        self.warnings += 1
        self._hear(Said(self.name, text, warning=True))

    show = say

    @contextmanager
    def counted(self, what: str, labels: bool = False) -> Iterator[Progress]:
        def progress(done: int, total: int | None) -> None:
            if labels:
                self._hear(Scans(self.name, done, total))

        yield progress
