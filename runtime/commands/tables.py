"""Tables that the command `mos` prints on stdout."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from runtime.doctor.findings import Finding, percent
from runtime.image.precision import choose_precision

if TYPE_CHECKING:
    from mos_model.simulator.demo import Demo
    from runtime.bundle.manifest import Bundle
    from runtime.predict import Summary

COLOURS = {"ok": "green", "warn": "yellow", "bad": "red"}


def show_summary(name: str, summary: "Summary") -> None:
    """What was done, how long a scan took, and where the predictions are."""
    console = Console(highlight=False, markup=False)
    already = f", {summary.resumed} were there already" if summary.resumed else ""
    console.print(f"sequence {name}: {summary.scans} scans{already}")
    if summary.scans:
        share = percent(summary.moving / max(1, summary.points))
        console.print(f"{summary.points:,} points, {share} moving")
        table = Table("ms a scan", box=None, pad_edge=False)
        for column in ("median", "p95"):
            table.add_column(column, justify="right")
        for stage, seconds in summary.latency.items():
            median, p95 = np.percentile(1000 * np.asarray(seconds), [50, 95])
            table.add_row(stage, f"{median:.1f}", f"{p95:.1f}", style="bold" if stage == "scan" else "")
        console.print(table)
    console.print(f"predictions: {summary.folder}", soft_wrap=True)


def show_demo(demo: "Demo") -> None:
    """What was found and how fast, where the pictures are, and what to try next."""
    console, scores, summary = Console(highlight=False, markup=False), demo.scores, demo.summary
    milliseconds = 1000 * np.asarray(summary.latency["scan"])
    median, p95 = np.percentile(milliseconds, [50, 95])
    points = summary.points / summary.scans
    rows = {
        "moving points": f"IoU {_share(scores.iou)}, precision {_share(scores.precision)}, "
        f"recall {_share(scores.recall)} of {summary.scans} scans of one street",
        "a scan": f"{median:.0f} ms (95th percentile {p95:.0f} ms) for {points:,.0f} points, read and written",
        "scans a second": f"{1000 / milliseconds.mean():.1f}",
        "pictures": " ".join(map(str, demo.pictures)) or demo.no_pictures,
        "labels": str(summary.folder),
        "all of it": f"{demo.seconds:.0f} s",
    }
    table = Table(box=None, show_header=False, pad_edge=False)
    for key, text in rows.items():
        table.add_row(Text(key, style="bold"), Text(text))
    console.print(table)
    out = demo.sequence.parents[2]
    console.print("next:", style="bold")
    for command, what in (
        ("mos doctor YOUR_SEQUENCE", "does your data fit? (KITTI layout, or a folder of scans with poses.txt)"),
        ("mos run YOUR_SEQUENCE", "a label for every point of it"),
        ("mos view YOUR_SEQUENCE --predictions predictions --out it.gif", "look at them"),
        (f"mos eval {out / 'predictions'} {out / 'street'}", "the scores above by range and class"),
    ):
        console.print(f"  {command}", soft_wrap=True)
        console.print(f"      {what}", style="dim", soft_wrap=True)


def _share(value: float) -> str:
    return "undefined (nothing moves)" if np.isnan(value) else f"{100 * value:.1f} %"


def show_findings(folder: Path, findings: list[Finding]) -> None:
    """A line a finding, and how many are not ok."""
    console = Console(highlight=False, markup=False)
    table = Table(box=None, show_header=False, pad_edge=False)
    for finding in findings:
        table.add_row(Text(finding.level, style=COLOURS[finding.level]), Text(finding.topic), Text(finding.text))
    bad, warn = (sum(finding.level == level for finding in findings) for level in ("bad", "warn"))
    console.print(f"{folder}", soft_wrap=True)
    console.print(table)
    console.print(f"{bad} bad, {warn} to look at" if bad or warn else "all well")


def _decision(threshold: float | None) -> str:
    return "the most likely class" if threshold is None else f"moving from {threshold:g} on"


def show_bundle(bundle: "Bundle") -> None:
    """Everything that the manifest says."""
    manifest = bundle.manifest
    sensor, residual, head = manifest.sensor, manifest.residual, manifest.point_head
    decision = manifest.decision
    rows = {
        "bundle": f"{manifest.name}, format {manifest.format}",
        "folder": str(bundle.path.resolve()),
        "network": _words({key: value for key, value in manifest.model.items() if _plain(value)}),
        "features": f"{manifest.features} channels",
        "sensor": f"{sensor.height} x {sensor.width} pixels, {sensor.fov_down:g} to {sensor.fov_up:g} deg",
        "normalisation": f"means {_numbers(sensor.mean)}; stds {_numbers(sensor.std)}",
        "residuals": f"{residual.kind}, lags {_numbers(residual.lags)}, {residual.min_range:g} to "
        f"{residual.max_range:g} m",
        "point head": "none" if head is None else _words(asdict(head)),
        "decision": f"pixels: {_decision(decision.threshold)}; point head: {_decision(decision.head_threshold)}",
        "postprocess": f"{manifest.postprocess} unless told otherwise",
        **{name: f"{entry.bytes / 1e6:.2f} MB, {entry.precision}" for name, entry in manifest.files.items()},
        "precision": "image network in {}: {}".format(*choose_precision(bundle, "auto", [])),
        "parity": _words(manifest.parity) or "not measured",
        "accuracy": _words(manifest.accuracy) or "not measured",
        "weights": _words(manifest.weights) or "unknown",
        "licence": manifest.licence,
    }
    table = Table(box=None, show_header=False, pad_edge=False)
    for key, text in rows.items():
        table.add_row(Text(key, style="bold"), Text(text))
    Console(highlight=False, markup=False).print(table)


def _plain(value: Any) -> bool:
    """Whether a value of the model has no row of its own (sensor, residuals, point head have)."""
    return value is not None and not isinstance(value, Mapping | list | tuple)


def _words(values: Mapping[str, Any], prefix: str = "") -> str:
    """A mapping as "key value, key value"; a mapping within it gives "outer key value"."""
    parts = []
    for key, value in values.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            parts.append(_words(value, f"{name} "))
        elif isinstance(value, bool):
            parts.append(f"{name} {'yes' if value else 'no'}")
        elif isinstance(value, list | tuple):
            parts.append(f"{name} {_numbers(value) or 'none'}")
        else:
            parts.append(f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}")
    return ", ".join(part for part in parts if part)


def _numbers(values: Any) -> str:
    return " ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)
