"""Manifests of format 1: one sensor without a name, its thresholds beside it, the kind of network among its options."""

from collections.abc import Mapping
from typing import Any

from runtime.errors import BundleError, MosError
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import name_of
from runtime.typed_json import build


def upgraded(values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The same as a manifest of format 2. Raises BundleError where it has no sensor or no network."""
    parts = dict(values)
    model = parts.get("model")
    if not isinstance(model, Mapping) or "sensor" not in parts:
        raise BundleError(f"{where}: has no {'model' if 'sensor' in parts else 'sensor'}")
    image = parts.pop("sensor")
    entry = {"name": _name_of(image), "range_image": image, "decision": parts.pop("decision", {})}
    return {**parts, "format": 2, "network": model.get("network", "unknown"), "sensors": [entry]}


def _name_of(image: Any) -> str:
    """The sensor whose range image this is."""
    try:
        return name_of(build(RangeImage, image, "sensor")) or "unknown"
    except MosError:  # which is said when the manifest is built
        return "unknown"
