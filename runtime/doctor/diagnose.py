"""`mos doctor`: looks at a recording and says in plain words what does not fit the network."""

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from runtime.bundle.choice import Choice
from runtime.doctor.check_alignment import check_alignment
from runtime.doctor.check_cloud import check_cloud
from runtime.doctor.check_files import check_files
from runtime.doctor.check_poses import check_rigid, check_steps, check_times
from runtime.doctor.check_scans import check_scans
from runtime.doctor.check_sensor import check_sensor
from runtime.doctor.findings import Finding
from runtime.doctor.pairs import geometry_of
from runtime.doctor.sample import Sample
from runtime.doctor.sensor_of import in_own_frame
from runtime.errors import MosError, MosWarning, PoseError, some
from runtime.recordings.around import Beginning
from runtime.recordings.recording import DEFAULTS, Indexed, Options
from runtime.recordings.registry import Found
from runtime.sensors.range_image import RangeImage

Locate = Callable[[Indexed], Indexed]

LOCATED = 300  # scans whose poses are found to see how an odometry does
SAMPLES = 12  # scans whose points are looked at, spread over the recording


def examine(
    found: Found,
    choose: Callable[[Indexed], Choice] | None = None,
    options: Options = DEFAULTS,
    locate: Locate | None = None,
) -> list[Finding]:
    """Findings about a recording that is yet to be opened: what stands in the way of that, then as `diagnose`.

    choose: the sensor that its scans are taken for, see `sensor_of`; None: it is compared with none.
    """
    problems: list[Finding] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MosWarning)
        try:
            recording = found.open(options)
        except PoseError as error:
            problems.append(Finding("bad", "poses", str(error)))
            recording = found.open(replace(options, points_only=True))
        except MosError as error:
            return [Finding("bad", "files", str(error))]
    told = [Finding("warn", "files", str(warning.message)) for warning in caught]
    locate = None if problems else locate
    if choose is None:
        return diagnose(recording, None, locate) + told + problems
    chosen = choose(recording)
    told.append(Finding("ok", "sensor", chosen.text))
    return diagnose(in_own_frame(recording, chosen), chosen.entry.range_image, locate) + told + problems


def diagnose(recording: Indexed, image: RangeImage | None = None, locate: Locate | None = None) -> list[Finding]:
    """Findings about a recording, best read in their order.

    image: what the network sees; None leaves that comparison out. locate: gives a recording without poses those that an
    odometry finds, of which some from its beginning are looked at. Broken scans become findings, not errors.
    """
    found = check_files(recording)
    samples = _read_samples(recording)
    if samples:
        found += check_scans(samples)
        found += check_cloud(recording)
        found += check_sensor(samples, image) if image else []
    if recording.times is not None:
        found += check_times(recording.times)
    if recording.poses is None and locate is not None:
        recording = locate(Beginning(recording, LOCATED))
        found.append(Finding("ok", "odometry", f"no poses; those of {len(recording)} scans by {recording.poses_from}"))
    if recording.poses is None:
        return found
    if recording.lost:
        lost = some([recording.keys[index] for index in recording.lost])
        found.append(Finding("warn", "odometry", f"lost at {lost}: what was seen before does not count there"))
    rigid = check_rigid(recording.poses)
    if any(finding.level == "bad" for finding in rigid):
        return found + rigid
    seen = [sample for sample in samples if sample.tells]
    geometry = geometry_of(seen[len(seen) // 2]) if seen else RangeImage()
    return found + rigid + check_steps(recording.poses) + [check_alignment(recording, recording.poses, geometry)]


def _read_samples(recording: Indexed) -> list[Sample]:
    """Some readable scans, spread over the recording."""
    found = []
    for i in np.unique(np.linspace(0, len(recording) - 1, SAMPLES).round().astype(int)):
        with contextlib.suppress(MosError):  # check_files has said so
            found.append(Sample.of(recording.read(int(i)).data))
    return found
