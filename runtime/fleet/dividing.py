"""A recording in pieces, which may be labelled side by side, to the bytes that one process writes.

First `begin`, then `label_piece` for each, in any order, and at last `end`.
"""

from dataclasses import replace
from pathlib import Path

from runtime.errors import MosError
from runtime.files import locked
from runtime.fleet.labelling import label_scans, prepare, warn_of_broken, write_beside
from runtime.fleet.plan import Task
from runtime.fleet.voice import Voice
from runtime.fleet.work import Work
from runtime.odometry.located import readable
from runtime.odometry.with_poses import with_poses
from runtime.predict import Summary, identity, predictions_folder
from runtime.recordings.around import Called
from runtime.recordings.journal import JOURNAL, Journal
from runtime.recordings.poses import check_pose
from runtime.recordings.recording import Indexed, Options
from runtime.recordings.registry import open_recording
from runtime.recordings.run_note import Settled, claim, close_pieces, settled_at
from runtime.runner import MosRunner


def begin(given: Indexed, runner: MosRunner, work: Work, voice: Voice) -> None:
    """Find the poses, the sensor and the scale of remission, and note them in `run.json`. Raises as `predict`."""
    recording, misfits = prepare(given, runner, work.options, work.folder, work.wanted, voice)
    folder = predictions_folder(work.folder, recording.name)
    shown_by = _shown_by(recording, runner)
    sensor = runner.sensor.name if runner.sensor else None
    settled = Settled(sensor, shown_by, recording.remission_scale(), tuple(sorted(misfits)))
    with locked(folder.parent):
        note = claim(folder, identity(recording, runner), recording, work.overwrite, settled)
        note.write(Journal(folder.with_name(JOURNAL)).broken())


def label_piece(work: Work, runner: MosRunner, task: Task, voice: Voice) -> Summary:
    """Label some scans of a recording. Raises as `predict`."""
    settled = settled_at(predictions_folder(work.folder, task.name))
    options = replace(work.options, remission_scale=work.options.remission_scale or settled.remission_scale)
    recording = _located(work, task, options)
    misfits = settled.misfits
    return label_scans(recording, runner, options, work.folder, work.wanted, voice, misfits, piece=task.piece)


def end(work: Work, runner: MosRunner, task: Task, voice: Voice) -> Summary:
    """Join what is known of the pieces, and write what is made of all of them, unless one failed."""
    folder = predictions_folder(work.folder, task.name)
    with locked(folder.parent):
        warn_of_broken(task.name, close_pieces(folder), voice)
    if not task.error and (work.wanted.clean or work.wanted.map or work.wanted.bag or work.wanted.cloud):
        write_beside(_located(work, task, work.options), runner, work.folder, work.wanted, voice)
    return Summary(folder)


def opened(task: Task, options: Options) -> Indexed:
    """The recording of a task. Raises as `open_recording`."""
    assert isinstance(task.place, Path)
    recording = open_recording(task.place, options)
    return Called(recording, task.source) if task.source else recording


def _located(work: Work, task: Task, options: Options) -> Indexed:
    """The recording, with the poses that `begin` found."""
    folder = predictions_folder(work.folder, task.name).parent
    return with_poses(opened(task, options), folder=folder, deskew=options.deskew, trusted=True)


def _shown_by(recording: Indexed, runner: MosRunner) -> int | None:
    """The number of the scan by which `predict` chooses the sensor, where none is given and one shows it."""
    runner.reset()
    if runner.sensor is None:
        for index, scan in readable(recording, range(len(recording)), lambda done, total: None):
            try:
                check_pose(scan.known_pose(), "pose")
                chosen = runner.choose_sensor(scan.data, scan.ring)
            except MosError:  # is said when it is labelled
                continue
            if chosen:
                return index
    return None
