"""Every error that this package raises on purpose: catch `MosError`, or the builtin that it also is."""


class MosError(Exception):
    """Base of all errors of this package. Each message says what was wrong, where, and what to do."""


class SettingError(MosError, ValueError):
    """A setting is outside what it may be (threads below 1, an unknown post-processing, ...)."""


class ScanError(MosError, ValueError):
    """A scan has the wrong shape, dtype or size."""


class PoseError(MosError, ValueError):
    """A pose is missing, not finite or not a rigid transform."""


class NoPosesError(PoseError):
    """A recording has no poses at all; odometry may find them."""


class LostError(PoseError):
    """An odometry cannot say how a scan lies to those before it."""


class SequenceError(MosError, ValueError):
    """A folder of scans, poses, calibration or labels does not fit together."""


class BundleError(MosError, ValueError):
    """A bundle is missing, incomplete, altered, or of a format that this version does not know."""


class CheckpointError(MosError, ValueError):
    """A checkpoint is not one, or does not hold the tensors of the network that it should."""


class TrainingError(MosError, RuntimeError):
    """Training cannot go on (the loss is not finite, ...); the last good checkpoint is kept."""


class ParityError(MosError, ArithmeticError):
    """An exported bundle does not compute what its checkpoint computes."""


class QuantisationError(MosError, ArithmeticError):
    """A network in 8-bit integers loses more accuracy than it may."""


class ProviderError(MosError, RuntimeError):
    """An execution provider that was asked for is not available."""


class InferenceError(MosError, RuntimeError):
    """The network failed, or returned values that are not finite."""


class MissingPackageError(MosError, ImportError):
    """An optional package is not installed; the message names the extra that brings it."""


class OutputError(MosError, OSError):
    """A result could not be written; what had been written before is whole."""


class CutShortError(OutputError):
    """A result is whole up to where it was cut short, and is kept under its temporary name, which the message says."""


class MosWarning(UserWarning):
    """Something that the user should know but that does not stop the work."""


def is_interrupt(error: BaseException) -> bool:
    """Whether the user ended it, or what it came from: compiled code makes other errors of that, as a SystemError."""
    before = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return isinstance(error, KeyboardInterrupt) or (before is not None and is_interrupt(before))


def some(names: list[str], most: int = 3) -> str:
    """The first few of `names`, and how many more there are: no message grows with the number of files."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def raise_all(problems: list[str], so: str, most: int = 5) -> None:
    """Raise SequenceError with the first problems and the number of all, if there are any."""
    if problems:
        lines = problems[:most] + ([f"and {len(problems) - most} more"] if len(problems) > most else [])
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        raise SequenceError(f"{count}, so {so}:\n  " + "\n  ".join(lines))
