"""The settings of `MosRunner`, which `mos run` offers by the same names."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from runtime.errors import SettingError
from runtime.sensors.registry import open_sensor
from runtime.sensors.sensor import Sensor

CHOICES = {
    "postprocess": ("none", "knn", "head"),
    "refine": ("near", "all"),
    "head_engine": ("auto", "numba", "onnx"),
    "precision": ("auto", "float32", "int8"),
    "belief": ("auto", "none", "online"),
}

LONGEST_DELAY = 50  # scans


@dataclass(frozen=True)
class RunnerSettings:
    """How a bundle is run. Raises SettingError for a value that there is not."""

    threads: int | None = None  # of the kernels and of ONNX Runtime; None: all processors that this process may use
    # "head": the point head refines points; "knn": they vote; "none": they take their pixel's; None: as the bundle says
    postprocess: str | None = None
    refine: str = "near"  # the point head looks "near" points that may move (others keep their pixel's), or at "all"
    # of the point head: "numba" on the processor, "onnx" on `providers`; "auto": "onnx" on a GPU's provider where the
    # bundle has `point_head.onnx`, else "numba"
    head_engine: str = "auto"
    # of the image network: "float32", "int8", or "auto": INT8 where the bundle has it and the processor gains from it
    precision: str = "auto"
    # "online": what the last scans found at a place counts there; "none": every scan by itself; "auto": "online" with a
    # delay, and where the bundle has numbers for it and points do not vote
    belief: str = "auto"
    delay: int = 0  # later scans that count too: a call returns the result of the scan so many calls before
    odometry: Any = None  # "kiss", or an `Odometry`: finds the poses that are not given; None: all must be
    deskew: bool = True  # points with times are brought to the middle of their sweep
    # a name of `runtime.sensors.registry`, a JSON file with the fields of `Sensor`, or a `Sensor`; None: that of the
    # bundle where it is for one, else the one that the first scan shows
    sensor: str | Path | Sensor | None = None
    nearest: float = 0.0  # m, nearer points take no part: the carrier itself, in view of the sensor
    body: tuple[float, ...] | None = None  # m, x y z of two corners of a box in the scan's frame: so do points within
    providers: Sequence[Any] | None = None  # of ONNX Runtime, best first, each a name or (name, options); None: the CPU
    allow_fallback: bool = False  # a provider that is not there is left out with a warning, instead of an error
    session_options: Mapping[str, str] = field(default_factory=dict)  # of ONNX Runtime's session configuration

    def __post_init__(self) -> None:
        for name, known in CHOICES.items():
            value = getattr(self, name)
            if value not in known and not (name == "postprocess" and value is None):
                raise SettingError(f"{name} must be one of {', '.join(known)}, not {value!r}")
        if isinstance(self.providers, str):
            raise SettingError(f"providers must be a list of names, as [{self.providers!r}]")
        if not 0 <= self.nearest < math.inf:
            raise SettingError(f"nearest must be a distance in m, not {self.nearest!r}")
        if self.body is not None and (len(self.body) != 6 or not all(map(math.isfinite, self.body))):
            raise SettingError(f"body must be x y z of two corners of a box in m, six numbers, not {self.body!r}")
        if isinstance(self.delay, bool) or not isinstance(self.delay, int) or not 0 <= self.delay <= LONGEST_DELAY:
            raise SettingError(f"delay must be a whole number of 0 to {LONGEST_DELAY} scans, not {self.delay!r}")
        if self.delay and self.belief == "none":
            raise SettingError("a delay without belief gains nothing: choose belief 'online', or no delay")
        _ = self.profile  # which raises what is wrong about it

    @cached_property
    def profile(self) -> Sensor | None:
        """The sensor that is given."""
        return None if self.sensor is None else open_sensor(self.sensor)

    def changed(self, changes: Mapping[str, Any]) -> "RunnerSettings":
        """These settings but for some. Raises SettingError for a name that there is not."""
        names = [one.name for one in fields(self)]
        if unknown := [name for name in changes if name not in names]:
            raise SettingError(f"there is no setting {', '.join(unknown)}; there are {', '.join(names)}")
        return replace(self, **changes)
