"""Options of `mos run` that are the settings of `MosRunner`, by their names."""

from typing import Annotated, Any

import typer

from runtime.commands.options import wrong_usage
from runtime.settings import CHOICES, LONGEST_DELAY, RunnerSettings

DEFAULTS = RunnerSettings()


def _option(*names: str, **shown: Any) -> Any:
    return typer.Option(*names, rich_help_panel="How the bundle is run", **shown)


def _choice(setting: str, **shown: Any) -> Any:
    return _option(metavar="|".join(CHOICES[setting]), **shown)


def _scans_of_delay(given: str | int) -> int:
    """Raises BadParameter. "all": of a whole recording the longest delay, beyond which little changes."""
    text = str(given)  # the default is a number
    if text == "all":
        return LONGEST_DELAY
    if not text.isdecimal() or int(text) > LONGEST_DELAY:
        raise typer.BadParameter(f"{text!r} is neither a number of scans, 0 to {LONGEST_DELAY}, nor all")
    return int(text)


Postprocess = Annotated[str | None, _choice("postprocess", help="From pixels to points.", show_default="the bundle's")]
Refine = Annotated[
    str | None,
    _choice(
        "refine",
        help="The point head looks near points that may move, or at all.",
        show_default=DEFAULTS.refine,
    ),
]
HeadEngine = Annotated[
    str | None,
    _choice(
        "head_engine",
        help="The point head in Numba on the CPU, or in ONNX on the providers; auto: onnx on a GPU.",
        show_default=DEFAULTS.head_engine,
    ),
]
Precision = Annotated[
    str,
    _choice("precision", help="Of the image network; auto: int8 where the processor gains from it."),
]
Belief = Annotated[
    str,
    _choice("belief", help="online: what the last scans found at a place counts there, too."),
]
Delay = Annotated[
    int,
    _option(
        parser=_scans_of_delay,
        metavar="SCANS|all",
        help=f"Later scans that count for a label too, {LONGEST_DELAY} at most; all: as many.",
    ),
]
Nearest = Annotated[
    float, _option(min=0, metavar="M", help="Nearer points take no part: the carrier itself, in view of the sensor.")
]
Body = Annotated[
    str | None,
    _option(
        metavar="X,Y,Z,X,Y,Z",
        help="Two corners of a box in m, in the scans' frame: points within take no part.",
        show_default=False,
    ),
]
Providers = Annotated[
    list[str] | None,
    _option(
        "--provider",
        metavar="NAME[:KEY=VALUE,...]",
        help="Execution provider of ONNX Runtime; may be repeated, the preferred first.",
        show_default="the CPU",
    ),
]
Fallback = Annotated[bool, _option("--allow-fallback", help="Go on without a provider that is not there.")]
SessionOptions = Annotated[
    list[str] | None,
    _option(
        "--session-option",
        metavar="KEY=VALUE",
        help="Entry of ONNX Runtime's session configuration; may be repeated.",
        show_default=False,
    ),
]


def runner_settings(**values: Any) -> RunnerSettings:
    """The settings, of which none is wrong or would be ignored."""
    if values["allow_fallback"] and not values["providers"]:
        raise typer.BadParameter("--allow-fallback is for a --provider, and none is given")
    with wrong_usage():
        return RunnerSettings(**values)


def provider(text: str) -> str | tuple[str, dict[str, str]]:
    """An execution provider as `MosRunner` takes it, of NAME or NAME:key=value,..."""
    name, colon, options = text.partition(":")
    return (name, dict(key_value(one) for one in options.split(","))) if colon else name


def corners(text: str) -> tuple[float, ...]:
    """The six numbers of --body."""
    try:
        return tuple(float(number) for number in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not X,Y,Z,X,Y,Z: two corners of a box, in m") from None


def key_value(text: str) -> tuple[str, str]:
    """("device_id", "0") of "device_id=0"."""
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise typer.BadParameter(f"{text!r} is not KEY=VALUE")
    return key, value
