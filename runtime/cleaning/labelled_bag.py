"""A bag in which every point says whether it moves: what is kept for it of each scan, and the bag itself."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.belief.result import MosResult
from runtime.classes import MOVING, to_classes
from runtime.errors import SequenceError
from runtime.files import replacing_folder, write_whole
from runtime.odometry.located import Progress
from runtime.recordings.labels import read_prediction
from runtime.recordings.recording import Indexed, Scan


class Probabilities:
    """A file for each scan: the probability that each of its points moves, (N,) float32, in NumPy's format."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, key: str) -> Path:
        return self._folder / f"{key}.npy"

    def write(self, scan: Scan, result: MosResult) -> None:
        data = BytesIO()
        np.save(data, result.probability)
        write_whole(self.path(scan.key), data.getbuffer(), sync=False)

    def read(self, key: str, points: int) -> NDArray[np.float32]:
        """Of a scan of so many points. Raises SequenceError."""
        try:
            found: NDArray[np.float32] = np.load(self.path(key), allow_pickle=False)
        except (OSError, ValueError) as error:
            raise SequenceError(f"{self.path(key)}: probabilities cannot be read: {error}") from error
        if found.shape != (points,) or found.dtype != np.float32:
            raise SequenceError(f"{self.path(key)}: is not of the {points} points of its scan; delete it")
        return found


def write_labelled_bag(
    recording: Indexed,
    labels: Path,
    probabilities: Probabilities,
    folder: Path,
    on_progress: Progress = lambda done, total: None,
) -> int:
    """The bag that a recording is from, its clouds with labels, in `folder`, which is whole or absent; how many.

    labels: folder of a label file for each scan; clouds without one are left out, all other messages are as they were.
    Raises SequenceError, SettingError where the recording is no bag, OutputError.
    """
    count = 0

    def labelled() -> Iterator[tuple[int, NDArray[np.bool_], NDArray[np.float32]]]:
        nonlocal count
        for index, key in enumerate(recording.keys):
            path, points = labels / f"{key}.label", recording.count(index)
            if path.is_file():  # else it was broken, which was said
                count += 1
                yield index, to_classes(read_prediction(path, points)) == MOVING, probabilities.read(key, points)
            on_progress(index + 1, len(recording))

    with replacing_folder(folder) as new:
        recording.write_labelled(new, labelled())
    return count
