"""Nobody but the readers knows a file format, and nobody but the runner what stands in for missing remission."""

import re

import pytest

from tests.support.paths import ROOT

WRITERS = {"mos_model/simulator/write.py"}  # write KITTI's layout


def sources():
    for room in ("runtime", "export", "mos_model", "bench"):
        for path in sorted((ROOT / room).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not name.startswith("runtime/recordings/") and name not in WRITERS:
                yield name, path.read_text()


@pytest.mark.parametrize(
    "spelling",
    [
        r"read_cloud\(",
        r"read_pose_table\(",
        r"read_calib\(",
        r"np\.fromfile",
        r"[\"']velodyne[\"']",
        r"[\"'](poses|calib|times)\.txt[\"']",
        r"[\"']\.(bin|npy|pcd|las|laz|feather)[\"']",
        r"remission_fill",
    ],
)
def test_file_formats_are_known_to_readers_alone(spelling):
    found = [name for name, text in sources() if re.search(spelling, text)]
    assert found == []
