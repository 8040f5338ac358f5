"""The manifest of a bundle: all there is to know about its network, as `manifest.json` holds it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from runtime.bundle.format_1 import upgraded
from runtime.bundle.head_shape import WIDEST, PointHeadConfig
from runtime.bundle.residual import Residual
from runtime.bundle.view import BirdView, CylinderView, View
from runtime.classes import CLASSES
from runtime.errors import BundleError, SettingError
from runtime.sensors.range_image import RangeImage
from runtime.sensors.sensor import FARTHEST, UNKNOWN_REACH
from runtime.typed_json import build

FORMAT = 2
MANIFEST = "manifest.json"
IMAGE_NET = "image_net.onnx"
IMAGE_NET_INT8 = "image_net_int8.onnx"
CYLINDER_NET = "cylinder_net.npz"
POINT_HEAD = "point_head.npz"
POINT_HEAD_ONNX = "point_head.onnx"
NETWORK_FILES = {  # and the precisions that they come in
    IMAGE_NET: ("float32", "float16"),
    IMAGE_NET_INT8: ("int8",),
    CYLINDER_NET: ("float32", "float16"),
    POINT_HEAD: ("float32", "float16"),
    POINT_HEAD_ONNX: ("float32", "float16"),
}


@dataclass(frozen=True)
class FileEntry:
    """One file of a bundle."""

    sha256: str
    bytes: int
    precision: str  # "float32", "float16" (stored so, computed in float32) or "int8"


@dataclass(frozen=True)
class Decision:
    """When a pixel or point counts as moving."""

    threshold: float | None = None  # probability of "moving" from which it is; None: the most likely class
    head_threshold: float | None = None  # the same for probabilities of the point head
    belief_threshold: float | None = None  # the same where what past scans found counts too
    delayed_threshold: float | None = None  # the same where later scans count too

    def __post_init__(self) -> None:
        for threshold in (self.threshold, self.head_threshold, self.belief_threshold, self.delayed_threshold):
            if threshold is not None and not 0 <= threshold < 1:
                raise SettingError(f"the threshold of moving must be a probability below 1, not {threshold!r}")


@dataclass(frozen=True)
class SensorEntry:
    """A sensor that the network was made for, and what was calibrated for it."""

    name: str  # see `runtime.sensors.registry`
    range_image: RangeImage
    reach: float = UNKNOWN_REACH  # m, returns from beyond take no part
    decision: Decision = field(default_factory=Decision)

    def __post_init__(self) -> None:
        if not 0 < self.reach <= FARTHEST:
            raise SettingError(f"the reach of a sensor must be above 0 m, {FARTHEST:g} at most, not {self.reach!r}")


@dataclass(frozen=True)
class BeliefNumbers:
    """How what past scans found at a place counts there. Found on simulated streets with the weights of `rt`."""

    voxel_size: float = 0.25  # m, of a place
    horizon: int = 16  # scans that count; older ones do not at all
    weight: float = 0.2  # of the sum of their log-odds, beside those of the scan itself
    floor: float = -6.0  # of that product: what stood for long may start to move
    object_probability: float = 0.05  # from which on points in touching places are one object; 1: none are
    doubtful: float = 0.25  # probability from which on points are raised to what their object is believed to be
    sure: float = 0.75  # probability above which an object surely moves
    longest_trail: int = 8  # scans for which it counts as one that did so a moment ago
    in_trail: float = 1.0  # log-odds that this adds
    look_back: int = 29  # scans back, in the oldest of which the places of points that may move are looked at; 0: none
    through: float = 0.6  # log-odds of a look at a place that went on to something behind
    ended: float = -0.4  # of one that ended there
    unseen: float = -0.1  # of one that saw neither

    def __post_init__(self) -> None:
        if not 0.01 <= self.voxel_size <= 10:
            raise SettingError(f"a place must be 0.01 m to 10 m wide, not {self.voxel_size!r}")
        if not 1 <= self.horizon <= 64:
            raise SettingError(f"the horizon of belief must be 1 to 64 scans, not {self.horizon!r}")
        if not (0 <= self.weight <= 10 and -1000 <= self.floor <= 0):
            raise SettingError("belief takes a weight of 0 to 10 and a floor of -1000 to 0")
        if not 0 < self.object_probability <= 1:
            raise SettingError(f"points of objects have a probability above 0 to 1, not {self.object_probability!r}")
        if not (0 < self.doubtful < 1 and 0 < self.sure < 1):
            raise SettingError(
                f"what is doubtful, or sure, has a probability between 0 and 1, not {self.doubtful!r} and {self.sure!r}"
            )
        if not (0 <= self.longest_trail <= 64 and 0 <= self.in_trail <= 10):
            raise SettingError("a trail lasts 0 to 64 scans, and adds 0 to 10 of log-odds")
        if not 0 <= self.look_back <= 64:
            raise SettingError(f"belief looks back 0 to 64 scans, not {self.look_back!r}")
        if not all(-10 <= one <= 10 for one in (self.through, self.ended, self.unseen)):
            raise SettingError("what a look says (through, ended or unseen) is -10 to 10 of log-odds")


@dataclass(frozen=True)
class Tuned:
    """Numbers that were found for these weights. The defaults are those of bundles of format 1."""

    candidate: float = 0.2  # probability of its pixel from which a point may move: the point head looks around it
    halo: float = 0.6  # m around them that it looks at: 99.7 % of labels as with all voxels, at a third of the cost
    jump: float = 10.0  # m between two scans from which the history is dropped
    turn: float = 60.0  # degrees between two scans from which it is
    gap: float = 1.0  # s between two scans from which it is
    belief: BeliefNumbers | None = None  # None: not found for these weights, so that belief is off unless asked for

    def __post_init__(self) -> None:
        if not 0 <= self.candidate < 1:
            raise SettingError(f"the candidate's probability must be below 1, not {self.candidate!r}")
        for name in ("halo", "jump", "turn", "gap"):
            if not 0 <= getattr(self, name) < math.inf:
                raise SettingError(f"{name} must be finite and not negative, not {getattr(self, name)!r}")


@dataclass(frozen=True)
class Manifest:
    """What `manifest.json` holds."""

    name: str
    network: str  # kind of the image network
    sensors: tuple[SensorEntry, ...]  # the first is the one that a runner takes
    residual: Residual
    features: int  # channels of the feature map
    point_head: PointHeadConfig | None
    files: Mapping[str, FileEntry]
    weights: Mapping[str, Any]  # where they come from: "source", "trained", ...
    model: Mapping[str, Any]  # the configuration that the network was built from
    format: int = FORMAT
    classes: tuple[str, ...] = CLASSES
    tuned: Tuned = field(default_factory=Tuned)
    postprocess: str = "none"  # "none", "knn" or "head": what a runner does unless told otherwise
    parity: Mapping[str, Any] = field(default_factory=dict)  # largest differences from PyTorch
    accuracy: Mapping[str, Any] = field(default_factory=dict)
    licence: str = "unknown"  # of the weights
    bird: BirdView | None = None  # the network looks from above
    cylinder: CylinderView | None = None  # the network sees points in a cylinder; neither: the view from the sensor

    @property
    def sensor(self) -> SensorEntry:
        """The sensor that a runner takes."""
        return self.sensors[0]

    @property
    def postprocesses(self) -> tuple[str, ...]:
        """What it can have for `postprocess`, the plainest first. Points do not vote, and only a head refines."""
        images, refines = self.cylinder is None, self.point_head is not None
        return "none", *(("knn",) if images else ()), *(("head",) if refines else ())

    def view(self, sensor: SensorEntry) -> View:
        """What the network is shown of the scans of a sensor."""
        return View(sensor.range_image, self.residual, self.bird, self.cylinder)


def parse_manifest(values: Any, where: str) -> Manifest:
    """A manifest from what its JSON holds, of this format or format 1.

    Raises BundleError, beginning with `where`, that names what is unknown, missing or wrong.
    """
    if not isinstance(values, dict) or type(values.get("format")) is not int:
        raise BundleError(f"{where}: is no manifest of a bundle (it has no format number)")
    if values["format"] == 1:
        values = upgraded(values, where)
    if values["format"] != FORMAT:
        raise BundleError(
            f"{where}: is of format {values['format']}, this version of lidar-mos reads formats 1 and {FORMAT}; "
            f"{'update lidar-mos' if values['format'] > FORMAT else 'export the checkpoint again'}"
        )
    manifest = build(Manifest, values, where, BundleError)
    if wrong := _contradictions(manifest):
        raise BundleError(f"{where}: {'; '.join(wrong)}")
    return manifest


def _contradictions(manifest: Manifest) -> list[str]:
    """What in a manifest cannot be, or does not fit together."""
    wrong = []
    if not manifest.sensors:
        wrong.append("lists no sensor")
    images = {IMAGE_NET, IMAGE_NET_INT8} & set(manifest.files)
    if manifest.cylinder is None and not images:
        wrong.append("lists no image network under 'files'")
    if (manifest.cylinder is not None) != (CYLINDER_NET in manifest.files):
        wrong.append(f"'cylinder' and the file {CYLINDER_NET} must both be there, or neither")
    if manifest.cylinder is not None and (images or manifest.bird is not None):
        wrong.append("a network that sees points in a cylinder has neither an image network nor a view from above")
    if manifest.cylinder is not None and not 2 <= manifest.features <= WIDEST:
        wrong.append(f"a network that sees points in a cylinder has 2 to {WIDEST} features, not {manifest.features}")
    for name, entry in manifest.files.items():
        if name not in NETWORK_FILES:
            wrong.append(f"file {name!r} is not one that a bundle holds")
        elif entry.precision not in NETWORK_FILES[name]:
            wrong.append(f"{name} has precision {entry.precision!r}, not {' or '.join(NETWORK_FILES[name])}")
    head = manifest.point_head
    if manifest.classes != CLASSES:
        wrong.append(f"classes are {manifest.classes}, this version knows {CLASSES}")
    if (head is not None) != (POINT_HEAD in manifest.files):
        wrong.append(f"'point_head' and the file {POINT_HEAD} must both be there, or neither")
    if head is None and POINT_HEAD_ONNX in manifest.files:
        wrong.append(f"{POINT_HEAD_ONNX} is there, but no 'point_head'")
    if head is not None and head.in_channels != manifest.features:
        wrong.append(f"the point head takes {head.in_channels} features, the image network gives {manifest.features}")
    if manifest.postprocess not in manifest.postprocesses:
        can = " or ".join(manifest.postprocesses)
        wrong.append(f"postprocess {manifest.postprocess!r} is unknown, or not for such a network: it can have {can}")
    return wrong
