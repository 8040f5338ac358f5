"""Writing pictures: what comes out depends on the name of the file."""

import io
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.compute.packages import PILLOW, RERUN, need_package
from runtime.errors import SequenceError, SettingError
from runtime.files import write_whole
from runtime.pictures.snapshot import Snapshot

if TYPE_CHECKING:
    from PIL.Image import Image

KINDS = {".png": "a picture", ".gif": "a moving picture", ".rrd": "a 3D recording"}
SCAN_MS, LAST_MS = 100, 1000  # how long a GIF shows each scan (10 Hz, as the sensor turns), and the last one


def check_output(path: str | Path) -> str:
    """The kind of picture that `path` asks for: its suffix, .png, .gif or .rrd.

    Raises SettingError for another, MissingPackageError without the package that makes it.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in KINDS:
        known = ", ".join(f"{name} ({what})" for name, what in KINDS.items())
        raise SettingError(f"{path}: the name must end with one of {known}")
    need_package(RERUN if suffix == ".rrd" else PILLOW, f"{suffix}, {KINDS[suffix]},")
    return suffix


def write_picture(path: str | Path, shown: Iterable[Snapshot], show: bool = False) -> int:
    """Write snapshots to a .png (the first one), .gif or .rrd (all of them); the number of scans that it shows.

    Snapshots are taken one at a time. show: an .rrd is played in Rerun's viewer meanwhile. Raises as `check_output`,
    SequenceError without a snapshot, OutputError.
    """
    path = Path(path)
    suffix = check_output(path)
    scans = iter(shown)
    first = next(scans, None)
    if first is None:
        raise SequenceError(f"{path}: there is no scan to show")
    if suffix == ".rrd":
        from runtime.pictures.rerun_file import open_viewer, record

        return record(path, chain([first], scans), [open_viewer()] if show else [])
    data = io.BytesIO()
    count = 1
    if suffix == ".png":
        _page(first).save(data, "PNG", optimize=True)
    else:
        pages = [_page(first), *map(_page, scans)]
        count = len(pages)
        times = [SCAN_MS] * (count - 1) + [LAST_MS]
        pages[0].save(data, "GIF", save_all=True, append_images=pages[1:], duration=times, loop=0)
    write_whole(path, data.getvalue())
    return count


def _page(snapshot: Snapshot) -> "Image":
    """The picture of a scan with 256 colours, a byte a pixel."""
    from PIL.Image import Dither

    from runtime.pictures.sheet import draw_sheet, palette

    return draw_sheet(snapshot).quantize(palette=palette(), dither=Dither.NONE)
