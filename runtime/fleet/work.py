"""What is to be done with each of many recordings."""

import socket
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from runtime import __version__
from runtime.bundle.loading import load_bundle, sha256_of
from runtime.bundle.manifest import MANIFEST
from runtime.compute.sessions import provider_name
from runtime.errors import BundleError
from runtime.fleet.remote import Place
from runtime.fleet.wanted import Wanted
from runtime.image.precision import choose_precision
from runtime.recordings.extrinsics import read_extrinsics
from runtime.recordings.recording import Options
from runtime.runner import MosRunner
from runtime.settings import RunnerSettings


@dataclass(frozen=True)
class Work:
    """The same for all recordings, in whatever process of whatever machine; `settle` makes it."""

    bundle: Path | None  # None: the one that is installed
    manifest_sha256: str  # of the bundle
    settings: RunnerSettings
    options: Options
    out: Place
    overwrite: bool
    wanted: Wanted
    piece: int | None = None  # scans of a piece, where recordings of more are divided
    version: str = __version__  # of this package

    @property
    def folder(self) -> Path:
        """`out`, once it is on this machine: see `at_hand`."""
        assert isinstance(self.out, Path)
        return self.out

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


def settle(
    bundle: Path | None,
    settings: RunnerSettings,
    options: Options,
    out: Place,
    overwrite: bool,
    wanted: Wanted,
    piece: int | None = None,
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
        out.absolute() if isinstance(out, Path) else out,
        overwrite,
        wanted,
        piece,
    )
