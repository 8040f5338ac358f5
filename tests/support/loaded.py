"""Where the processes of `moments` begin: all that `mos run` needs is loaded, and its kernels are compiled."""

import contextlib
import io
import tempfile

import tests.support.moments  # noqa: F401 - which begins here
from runtime.commands.main import main
from tests.support.paths import BUNDLE, TINY

with (
    tempfile.TemporaryDirectory() as _folder,
    contextlib.redirect_stdout(io.StringIO()),
    contextlib.redirect_stderr(io.StringIO()),
):
    _options = ["--bundle", str(BUNDLE), "--threads", "1", "--limit", "2", "--out", _folder]
    _written = ["--write", "cloud", "--write", "map", "--write", "static"]
    main(["run", str(TINY / "scans" / "sequences" / "00"), *_options, *_written])
