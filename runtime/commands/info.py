"""`mos info`: everything that a manifest says."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from runtime.commands.options import INSTALLED
from runtime.commands.output import show_facts, show_line, show_rows

if TYPE_CHECKING:
    from runtime.bundle.loading import Bundle
    from runtime.bundle.manifest import Manifest, SensorEntry


def info(
    bundle: Annotated[
        Path | None, typer.Argument(metavar="BUNDLE", help="Bundle folder.", show_default=INSTALLED)
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="Run each network once too, and say what was checked.")
    ] = False,
) -> None:
    """Show what a bundle is: network, sensor, files, agreement with PyTorch, accuracy."""
    from runtime.bundle.loading import load_bundle

    loaded = load_bundle(bundle)
    show_bundle(loaded)
    if verify:
        from runtime.head.verification import verify as verified

        show_line("\nchecked:")
        show_rows(list(verified(loaded)))


def show_bundle(bundle: "Bundle") -> None:
    """Print the manifest as a table, in words."""
    from runtime.image.precision import choose_precision

    manifest = bundle.manifest
    image, head = manifest.sensor.range_image, manifest.point_head
    rows = {
        "bundle": f"{manifest.name}, format {manifest.format}",
        "folder": os.path.realpath(bundle.path),
        "network": _words({key: value for key, value in manifest.model.items() if _plain(value)}),
        "features": f"{manifest.features} channels",
        **_sensors(manifest.sensors),
        "normalisation": f"means {_numbers(image.mean)}; stds {_numbers(image.std)}",
        **_past(manifest),
        "point head": "none" if head is None else _words(asdict(head)),
        "postprocess": f"{manifest.postprocess} unless told otherwise",
        **{name: f"{entry.bytes / 1e6:.2f} MB, {entry.precision}" for name, entry in manifest.files.items()},
        "precision": "image network in {}: {}".format(*choose_precision(bundle, "auto", [])),
        "parity": _words(manifest.parity) or "not measured",
        "accuracy": _words(manifest.accuracy) or "not measured",
        "weights": _words(manifest.weights) or "unknown",
        "licence": manifest.licence,
    }
    show_facts(rows)


def _sensors(sensors: Iterable["SensorEntry"]) -> dict[str, str]:
    """A row for each."""
    rows = {}
    for one in sensors:
        image, decision = one.range_image, one.decision
        rows[f"sensor {one.name}"] = (
            f"{image.height} x {image.width} pixels, {image.fov_down:.4g} to {image.fov_up:.4g} deg, up to "
            f"{one.reach:g} m; pixels: {_decision(decision.threshold)}; point head: "
            f"{_decision(decision.head_threshold)}; belief: {_decision(decision.belief_threshold)}"
        )
    return rows


def _past(manifest: "Manifest") -> dict[str, str]:
    """How the past is shown to the network."""
    residual, lags = manifest.residual, f"lags {_numbers(manifest.residual.lags)}"
    for title, view in (("from above", manifest.bird), ("points in a cylinder", manifest.cylinder)):
        if view is not None:
            return {"view": f"{title}, {_words(asdict(view))}", "past scans": lags}
    return {"residuals": f"{residual.kind}, {lags}, {residual.min_range:g} to {residual.max_range:g} m"}


def _decision(threshold: float | None) -> str:
    return "the most likely class" if threshold is None else f"moving from {threshold:g} on"


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
