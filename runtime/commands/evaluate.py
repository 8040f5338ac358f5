"""`mos eval`: the scores of predictions, or the archive for the benchmark's server."""

from pathlib import Path
from typing import Annotated

import typer

from runtime.commands.options import Names


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
    names: Names = None,
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
    picked = tuple(names or ())
    if archive is not None and out is not None:
        raise typer.BadParameter("--out takes scores, and --zip packs without scoring: give one of them")
    if archive is None and truth is None:
        raise typer.BadParameter("TRUTH is missing: the root of the data set with labels (or --zip OUT.zip)")

    from runtime.commands.progress import counted
    from runtime.commands.scores import show_packed, show_scores

    if archive is not None:
        from runtime.evaluation.submission import check, pack

        submission = check(predictions, truth, picked)
        with counted("files") as progress:
            pack(submission, archive, progress)
        show_packed(submission, archive)
    elif truth is not None:
        from runtime.evaluation.layout import pair
        from runtime.evaluation.report import save_scores, score

        frames = pair(predictions, truth, picked)
        with counted("scans") as progress:
            report = score(frames, progress)
        show_scores(report)
        if out is not None:
            save_scores(out, report)
