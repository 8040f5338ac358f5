"""A picture of a recording: which scans, by what systems, into which file."""

from collections.abc import Callable, Iterator
from pathlib import Path

from runtime.bundle.residual import HISTORY
from runtime.errors import SettingError
from runtime.pictures.output import check_output, write_picture
from runtime.pictures.snapshot import Live, Snapshot, Stored, System, snapshots
from runtime.recordings.recording import Indexed
from runtime.sensors.sensor import Sensor

COUNT = 30  # scans of a GIF or recording unless told otherwise


def draw(
    recording: Indexed,
    out: str | Path,
    *,
    predictions: Path | None = None,
    compare: Path | None = None,
    scan: int | None = None,
    count: int | None = None,
    bundle: Path | None = None,
    sensor: str | Path | Sensor | None = None,
    threads: int = 2,
    deskew: bool = True,
    nearest: float = 0.0,
    body: tuple[float, ...] | None = None,
    show: bool = False,
    on_progress: Callable[[int, int], object] = lambda done, total: None,
) -> int:
    """Write the picture `out` of a recording; the number of scans in it.

    predictions: root or folder of .label files; None: what `bundle`, or the default one, says, for `sensor`: see
        `RunnerSettings`.
    compare: such files of a second system, shown beside the first.
    scan: position in the recording, from 0: of the one scan of a .png (None: in the middle), of the first one of
        `count` scans (None: COUNT) of a .gif or .rrd (None: 0).
    nearest, body: see `RunnerSettings`.
    show: an .rrd is played in Rerun's viewer while it is made.

    Raises SettingError, SequenceError, MissingPackageError, OutputError and what a runner raises.
    """
    suffix = check_output(out)
    if suffix == ".png" and count is not None:
        raise SettingError(f"{out}: a .png shows one scan, so that `count` has no meaning; choose which by `scan`")
    chosen = choose_scans(recording, suffix, scan, count)
    systems: list[System] = [Stored(root, recording) for root in (predictions, compare) if root is not None]
    if predictions is None:
        from runtime.runner import MosRunner

        runner = MosRunner(bundle, threads=threads, sensor=sensor, deskew=deskew, nearest=nearest, body=body)
        systems.insert(0, Live(runner, recording))

    def reported() -> Iterator[Snapshot]:
        for done, one in enumerate(snapshots(recording, systems, chosen)):
            on_progress(done, len(chosen))
            yield one

    shown = write_picture(out, reported(), show)
    on_progress(shown, len(chosen))
    return shown


def choose_scans(recording: Indexed, suffix: str, scan: int | None, count: int | None) -> range:
    """The scans that a picture shows, see `draw`. Raises SettingError where there is none."""
    count = 1 if suffix == ".png" else COUNT if count is None else count
    if count < 1:
        raise SettingError(f"count must be at least 1, not {count}")
    last = len(recording) - 1
    if scan is None:  # a single one with a full history, if there is any
        scan = min(max(last // 2, HISTORY), last) if count == 1 else 0
    if not 0 <= scan <= last:
        raise SettingError(
            f"there is no scan {scan}: sequence {recording.name} has the scans 0 to {last} (by position)"
        )
    return range(scan, min(scan + count, last + 1))
