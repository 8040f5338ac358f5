"""Clouds of scans in which each point says whether it moves."""

from pathlib import Path

import numpy as np

from runtime.belief.result import MosResult
from runtime.cleaning.cleaning import columns_of
from runtime.files import write_whole
from runtime.recordings.formats.writing import WRITERS
from runtime.recordings.recording import Scan


class LabelledClouds:
    """A file for each scan: its points as the network got them, `moving` (0 or 1) and `probability`."""

    def __init__(self, folder: Path, form: str) -> None:
        """form: of WRITERS."""
        self._folder, self._form = folder, form

    def path(self, key: str) -> Path:
        return self._folder / f"{key}.{self._form}"

    def write(self, scan: Scan, result: MosResult) -> None:
        columns = {**columns_of(scan), "moving": result.moving.astype(np.uint8), "probability": result.probability}
        write_whole(self.path(scan.key), WRITERS[self._form](columns), sync=False)
