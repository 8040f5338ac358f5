"""The command `mos`. Heavy imports wait until the arguments are read."""

import sys
import warnings
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from runtime import __version__
from runtime.errors import BundleError, MissingPackageError, MosError, MosWarning, SettingError

if TYPE_CHECKING:
    from runtime.sensors.range_image import RangeImage

app = typer.Typer(
    help="Moving-object segmentation of LiDAR scans on a plain CPU.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


class PoseFrame(StrEnum):
    """Whose poses a file holds."""

    CAMERA = "camera"
    LIDAR = "lidar"


class Postprocess(StrEnum):
    """What turns the image network's classes into those of points."""

    NONE = "none"
    KNN = "knn"
    HEAD = "head"


INSTALLED = "the one that is installed"

Input = Annotated[
    Path,
    typer.Argument(
        metavar="INPUT",
        help="A KITTI sequence (.../sequences/NN), a root with several, or a folder of .bin or .npy scans.",
    ),
]
Bundle = Annotated[Path | None, typer.Option(help="Bundle to use.", show_default=INSTALLED)]
Names = Annotated[
    list[str] | None,
    typer.Option("--sequence", help="Sequence under a root; may be repeated.", show_default="all"),
]
Poses = Annotated[
    Path | None, typer.Option(help="Pose file.", show_default="poses.txt of the sequence, or poses/NN.txt")
]
Calib = Annotated[
    Path | None, typer.Option(help="KITTI calibration with Tr.", show_default="calib.txt of the sequence")
]
Frame = Annotated[
    PoseFrame | None,
    typer.Option(help="The poses are those of KITTI's camera or of the LiDAR itself.", show_default="camera"),
]


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"lidar-mos {__version__}")
        raise typer.Exit


@app.command()
def run(
    path: Input,
    out: Annotated[Path, typer.Option(help="Folder for sequences/NN/predictions/*.label.")] = Path("predictions"),
    bundle: Bundle = None,
    threads: Annotated[int, typer.Option(min=1, help="Threads to use.")] = 2,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Only the first scans of a sequence.", show_default="all")
    ] = None,
    sequence: Names = None,
    poses: Poses = None,
    pose_frame: Frame = None,
    calib: Calib = None,
    postprocess: Annotated[
        Postprocess | None, typer.Option(help="From pixels to points.", show_default="the bundle's")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace predictions instead of continuing them.")
    ] = False,
) -> None:
    """Label every point of a sequence: 251 moving, 9 everything else, in SemanticKITTI's layout.

    An interrupted run goes on where it was when the same command is given again.
    """
    from runtime.recordings.sequence import find_sequences, open_sequence

    folders = find_sequences(path, tuple(sequence or ()))
    if len(folders) > 1 and (poses or calib):
        raise SettingError(f"--poses and --calib are for one sequence, not for {len(folders)}; pick one by --sequence")
    sequences = [open_sequence(folder, poses, calib, pose_frame, limit) for folder in folders]

    from runtime.commands.progress import predict_with_progress
    from runtime.commands.tables import show_summary
    from runtime.runner import MosRunner

    try:
        runner = MosRunner(bundle, threads=threads, postprocess=postprocess.value if postprocess else None)
        for folder, one in zip(folders, sequences, strict=True):
            _warn_of_misfits(folder, runner.bundle.manifest.sensor, poses, calib, pose_frame)
            show_summary(one.name, predict_with_progress(one, runner, out, overwrite))
    except (KeyboardInterrupt, SystemError) as error:
        # in the moment in which Numba hands a result over, an interrupt comes out as the cause of a SystemError
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        typer.echo("mos: interrupted. Finished predictions are kept; the same command goes on from there", err=True)
        raise typer.Exit(130) from None


@app.command()
def info(
    bundle: Annotated[
        Path | None, typer.Argument(metavar="BUNDLE", help="Bundle folder.", show_default=INSTALLED)
    ] = None,
) -> None:
    """Show what a bundle is: network, sensor, files, agreement with PyTorch, accuracy."""
    from runtime.bundle.manifest import load_bundle
    from runtime.commands.tables import show_bundle

    show_bundle(load_bundle(bundle))


@app.command()
def doctor(
    path: Input,
    bundle: Bundle = None,
    sequence: Names = None,
    poses: Poses = None,
    pose_frame: Frame = None,
    calib: Calib = None,
) -> None:
    """Look at scans and poses and say in plain words what does not fit. Exit code 1 if anything is bad."""
    from runtime.commands.tables import show_findings
    from runtime.doctor.diagnose import diagnose
    from runtime.recordings.sequence import find_sequences

    folders = find_sequences(path, tuple(sequence or ()))
    sensor = _sensor(bundle)
    bad = False
    for folder in folders:
        findings = diagnose(folder, sensor, poses, calib, pose_frame)
        show_findings(folder, findings)
        bad |= any(finding.level == "bad" for finding in findings)
    raise typer.Exit(1 if bad else 0)


@app.command("eval")
def evaluate(
    predictions: Annotated[
        Path,
        typer.Argument(
            metavar="PREDICTIONS",
            help="Root with sequences/NN/predictions/*.label, as mos run and other tools write it, or one such folder.",
        ),
    ],
    truth: Annotated[
        Path | None,
        typer.Argument(
            metavar="TRUTH", help="Root of the data set, sequences/NN/labels/*.label, or one such sequence."
        ),
    ] = None,
    sequence: Names = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.json", help="Write the scores to a file too.")] = None,
    archive: Annotated[
        Path | None,
        typer.Option(
            "--zip",
            metavar="OUT.zip",
            help="Instead of scoring, check and pack the submission to the benchmark: sequences 11 to 21, or those of "
            "--sequence. TRUTH, if given, tells the scans.",
        ),
    ] = None,
) -> None:
    """Score predictions of any tool by the protocol of SemanticKITTI-MOS, or pack them for its server (--zip)."""
    names = tuple(sequence or ())
    if archive is not None and out is not None:
        raise typer.BadParameter("--out takes scores, and --zip packs without scoring: give one of them")
    if archive is None and truth is None:
        raise typer.BadParameter("TRUTH is missing: the root of the data set with labels (or --zip OUT.zip)")

    from runtime.commands.progress import counted
    from runtime.evaluation.table import show_packed, show_scores

    if archive is not None:
        from runtime.evaluation.submission import check, pack

        submission = check(predictions, truth, names)
        with counted("files") as progress:
            pack(submission, archive, progress)
        show_packed(submission, archive)
    elif truth is not None:
        from runtime.evaluation.layout import pair
        from runtime.evaluation.report import save_scores, score

        frames = pair(predictions, truth, names)
        with counted("scans") as progress:
            report = score(frames, progress)
        show_scores(report)
        if out is not None:
            save_scores(out, report)


@app.command()
def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New folder for sequences/NN.")],
    sequences: Annotated[int, typer.Option(min=1, help="Streets.")] = 1,
    frames: Annotated[int, typer.Option(min=1, help="Scans of each.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same data.")] = 0,
    sensor: Annotated[str, typer.Option(help="hdl64e, hdl32e, vlp16, os1-32, os1-64 or os1-128.")] = "hdl64e",
) -> None:
    """Write simulated streets with labels and poses, in SemanticKITTI's layout."""
    from mos_model.simulator.write import simulate_command
    from runtime.commands.progress import counted

    with counted("scans") as progress:
        done = simulate_command(out, sequences, frames, seed, sensor, progress)
    typer.echo(done)


@app.command()
def view(
    path: Input,
    predictions: Annotated[
        Path | None,
        typer.Option(help="Root or folder of .label files, of any tool.", show_default="what the bundle says now"),
    ] = None,
    compare: Annotated[
        Path | None, typer.Option(help="The same of a second system, shown beside the first.", show_default=False)
    ] = None,
    scan: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Position of the scan in the sequence, from 0; the first one of a .gif or .rrd.",
            show_default="middle of the sequence; 0",
        ),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="Scans of a .gif or .rrd.")] = 30,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Picture .png, animation .gif, or 3D recording .rrd for Rerun.")
    ] = Path("view.png"),
    show: Annotated[bool, typer.Option("--show", help="Open the recording in Rerun's viewer.")] = False,
    bundle: Bundle = None,
    threads: Annotated[int, typer.Option(min=1, help="Threads to use.")] = 2,
    sequence: Annotated[str | None, typer.Option(help="Sequence under a root.", show_default="the only one")] = None,
    poses: Poses = None,
    pose_frame: Frame = None,
    calib: Calib = None,
) -> None:
    """Draw what moves: found, missed and false movers where there are labels (extra 'view')."""
    from runtime.commands.progress import counted
    from runtime.pictures import check_output
    from runtime.pictures.command import check_viewer, open_viewer
    from runtime.pictures.command import view as draw
    from runtime.recordings.sequence import find_sequences, open_sequence

    check_output(out)
    if show:
        check_viewer(out)
    folders = find_sequences(path, (sequence,) if sequence else ())
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        raise SettingError(f"{path}: has the sequences {names}; pick one by --sequence")
    opened = open_sequence(folders[0], poses, calib, pose_frame)
    with counted("scans") as progress:
        draw(
            opened,
            out,
            predictions=predictions,
            compare=compare,
            scan=scan,
            count=count,
            bundle=bundle,
            threads=threads,
            on_progress=progress,
        )
    typer.echo(str(out))
    if show:
        open_viewer(out)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the street, the predictions and pictures.")] = Path("demo"),
    scans: Annotated[int, typer.Option(min=1, help="Scans to simulate.")] = 30,
    bundle: Bundle = None,
    threads: Annotated[int, typer.Option(min=1, help="Threads to use.")] = 2,
) -> None:
    """See the main job in a minute: simulate a street, find what moves in it, draw it."""
    from mos_model.simulator.demo import run_demo
    from runtime.commands.progress import stages
    from runtime.commands.tables import show_demo

    with stages() as report:
        done = run_demo(out, scans, bundle, threads, report)
    show_demo(done)


PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True}  # to the command's own parser


@app.command(context_settings=PASSED_ON, add_help_option=False)
def export(context: typer.Context) -> None:
    """Turn a checkpoint, ours or a published one, into a bundle (extra 'export'). See mos export --help."""
    _need("export", "torch", "onnx")
    from export.to_onnx import main

    raise typer.Exit(main(context.args))


@app.command(context_settings=PASSED_ON, add_help_option=False)
def train(context: typer.Context) -> None:
    """Train a network on SemanticKITTI or simulated streets (extra 'train'). See mos train --help."""
    _need("train", "torch")
    from mos_model.train import main

    raise typer.Exit(main(context.args))


def _need(extra: str, *packages: str) -> None:
    from importlib.util import find_spec

    if missing := [package for package in packages if find_spec(package) is None]:
        raise MissingPackageError(
            f"mos {extra} needs {' and '.join(missing)}, not installed here: pip install 'lidar-mos[{extra}]'"
        )


def _warn_of_misfits(
    folder: Path, sensor: "RangeImage", poses: Path | None, calib: Path | None, pose_frame: str | None
) -> None:
    """Say on stderr what makes the labels of a sequence worthless, such as poses in another frame."""
    from runtime.doctor.diagnose import diagnose

    for finding in diagnose(folder, sensor, poses, calib, pose_frame):
        if finding.level == "bad":
            typer.echo(f"mos: {folder}: {finding.topic}: {finding.text}. The labels will be wrong", err=True)


def _sensor(bundle: Path | None) -> "RangeImage | None":
    """The sensor that the bundle was made for; None where no bundle is given and none is installed."""
    from runtime.bundle.manifest import load_bundle

    try:
        return load_bundle(bundle).manifest.sensor
    except BundleError:
        if bundle is not None:
            raise
        typer.echo("mos: no bundle is installed: the sensor is not compared with any (--bundle)", err=True)
        return None


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `mos`. 0: done, 1: failed (stderr says why), 2: wrong usage, 130: interrupted."""
    with warnings.catch_warnings():
        warnings.simplefilter("default", MosWarning)
        warnings.showwarning = _show_warning
        try:
            app(arguments, prog_name="mos")
        except (MosError, OSError) as error:  # OSError: a folder that may not be read
            typer.echo(f"mos: {error}", err=True)
            return 1
        except SystemExit as done:  # how typer ends
            return done.code if isinstance(done.code, int) else 0
    return 0


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Ours without the place in the code, which says nothing to a user."""
    text = warnings.formatwarning(message, category, filename, lineno, line)
    typer.echo(f"mos: warning: {message}" if issubclass(category, MosWarning) else text, err=True)


if __name__ == "__main__":
    sys.exit(main())
