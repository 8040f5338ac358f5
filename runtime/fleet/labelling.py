"""What is done with a recording: find poses, label, write what is left, and say so."""

import warnings
from collections.abc import Iterable
from pathlib import Path

from runtime.cleaning.cleaning import CLEAN, SAME, write_clean, write_maps
from runtime.cleaning.labelled_bag import Probabilities, write_labelled_bag
from runtime.cleaning.labelled_clouds import LabelledClouds
from runtime.cleaning.votes import RecordingVotes
from runtime.compute.packages import PILLOW, has_package
from runtime.doctor.diagnose import diagnose
from runtime.doctor.findings import percent
from runtime.doctor.sensor_of import in_own_frame, sensor_of
from runtime.errors import MosWarning, some
from runtime.files import locked
from runtime.fleet.voice import Voice
from runtime.fleet.wanted import Wanted
from runtime.odometry.with_poses import with_poses
from runtime.predict import Output, Summary, predict, predictions_folder
from runtime.recordings.poses import Pose
from runtime.recordings.recording import Indexed, Options
from runtime.runner import MosRunner
from runtime.sensors.range_image import RangeImage


def label(
    given: Indexed, runner: MosRunner, options: Options, out: Path, overwrite: bool, wanted: Wanted, voice: Voice
) -> Summary:
    """All of it, of one recording; the voice is told what else was written. Raises what `predict` does, and readers."""
    recording, misfits = prepare(given, runner, options, out, wanted, voice)
    summary = label_scans(recording, runner, options, out, wanted, voice, misfits, overwrite=overwrite)
    warn_of_broken(recording.name, summary.broken, voice)
    write_beside(recording, runner, out, wanted, voice)
    return summary


def prepare(
    given: Indexed, runner: MosRunner, options: Options, out: Path, wanted: Wanted, voice: Voice
) -> tuple[Indexed, set[str]]:
    """The recording, with poses, and the topics on which it does not fit, which is said."""
    if wanted.bag:
        given.check_takes_labels()  # before anything is labelled
    recording = _located(given, options, predictions_folder(out, given.name).parent, voice)
    chosen = sensor_of(recording, runner.bundle.manifest, runner.settings.profile)
    own = in_own_frame(recording, chosen)
    return recording, _warn_of_misfits(own, chosen.entry.range_image, options.skip_broken, voice)


def label_scans(
    recording: Indexed,
    runner: MosRunner,
    options: Options,
    out: Path,
    wanted: Wanted,
    voice: Voice,
    misfits: Iterable[str],
    *,
    overwrite: bool = False,
    piece: range | None = None,
) -> Summary:
    """Labels, and what is written scan by scan beside them. misfits: topics on which enough is said."""
    labels = predictions_folder(out, recording.name)
    outputs: list[Output] = [_clouds(labels, wanted)] if wanted.cloud else []
    outputs += [_probabilities(labels)] if wanted.bag else []
    with warnings.catch_warnings(), voice.counted(f"sequence {recording.name}", labels=True) as progress:
        for topic in misfits:
            warnings.filterwarnings("ignore", f"{topic}: ", MosWarning)  # the runner's own word on it
        return predict(
            recording,
            runner,
            out,
            overwrite=overwrite,
            skip_broken=options.skip_broken,
            outputs=outputs,
            piece=piece,
            on_progress=progress,
        )


def warn_of_broken(name: str, broken: dict[str, str], voice: Voice) -> None:
    """Say which scans are left without a label, and why."""
    if broken:
        reasons = some([f"{key} ({reason})" for key, reason in broken.items()])
        voice.warn(f"sequence {name}: broken scans, left without a label: {len(broken)}: {reasons}")


def write_beside(recording: Indexed, runner: MosRunner, out: Path, wanted: Wanted, voice: Voice) -> None:
    """What is made of all labels of a recording. Raises OutputError where another run has begun to write there."""
    labels = predictions_folder(out, recording.name)
    with locked(labels.parent):  # what another run finds there that is not whole, it deletes
        if wanted.cloud:
            voice.show(f"clouds: {labels.with_name('clouds')}")
        if wanted.bag:
            with voice.counted(f"{recording.name} with labels") as progress:
                count = write_labelled_bag(recording, labels, _probabilities(labels), labels.with_name("bag"), progress)
            voice.show(f"bag with labels: {_what_is_in(labels.with_name('bag'))}, {count} clouds")
        if wanted.clean or wanted.map:
            chosen = sensor_of(recording, runner.bundle.manifest, runner.settings.profile)
            _write_left(recording, labels, wanted, chosen.mounting, voice)


def _clouds(labels: Path, wanted: Wanted) -> LabelledClouds:
    return LabelledClouds(labels.with_name("clouds"), wanted.form or "ply")


def _what_is_in(folder: Path) -> Path:
    """The bag in a folder, a file or a folder with its description, where that is all there is; else the folder."""
    there = list(folder.iterdir())
    bag = len(there) == 1 and (there[0].is_file() or (there[0] / "metadata.yaml").is_file())
    return there[0] if bag else folder


def _probabilities(labels: Path) -> Probabilities:
    return Probabilities(labels.with_name("probabilities"))


def _located(recording: Indexed, options: Options, folder: Path, voice: Voice) -> Indexed:
    """The recording, with poses by odometry where it has none, which are kept in the folder."""
    if recording.poses is not None:
        return recording
    with voice.counted(f"poses of {recording.name}") as progress:
        return with_poses(recording, folder=folder, deskew=options.deskew, on_progress=progress)


def _warn_of_misfits(recording: Indexed, image: RangeImage, skip_broken: bool, voice: Voice) -> set[str]:
    """Say what makes the labels of a recording worthless, such as poses in another frame; its topics.

    skip_broken: not what is broken, which is said at the end.
    """
    bad = [finding for finding in diagnose(recording, image) if finding.level == "bad"]
    told = [finding for finding in bad if not (skip_broken and finding.topic in ("scans", "poses"))]
    for finding in told:
        voice.warn(f"{recording.source}: {finding.topic}: {finding.text}. The labels will be wrong")
    return {finding.topic for finding in told}


def _write_left(recording: Indexed, labels: Path, wanted: Wanted, mounting: Pose | None, voice: Voice) -> None:
    """The static map, and the recording without what moves, beside the folder of its labels."""
    with voice.counted(f"what moves in {recording.name}") as progress:
        votes = RecordingVotes(recording, labels, wanted.voxel, progress, mounting)
    if wanted.map:
        for path, points in write_maps(votes, labels.parent).items():
            voice.show(f"static map: {path}, {points:,} points")
        if wanted.picture and not has_package(PILLOW):
            voice.show("no picture from above, which needs Pillow: pip install 'lidar-mos[view]'")
        elif wanted.picture:
            from runtime.pictures.map_view import draw_map

            picture = labels.with_name("map.png")
            first = votes.stretches[0].votes
            draw_map(picture, first.static_map().points, first.moving().places)
            voice.show(f"from above, before and after: {picture}")
    if wanted.clean:
        with voice.counted(f"{recording.name} without it") as progress:
            left = write_clean(votes, labels.with_name(CLEAN), wanted.form or SAME, progress)
        share = percent(1 - left.kept / max(1, left.points))
        voice.show(
            f"without what moves: {_what_is_in(left.folder)}, {left.scans} scans, {share} of the points left out"
        )
