"""What the doctor finds, as an error and warnings: for work that must not begin on recordings that do not fit."""

import warnings
from collections.abc import Sequence

from runtime.doctor.diagnose import diagnose
from runtime.errors import MosWarning, raise_all
from runtime.recordings.recording import Indexed
from runtime.sensors.range_image import RangeImage


def demand_fit(recordings: Sequence[Indexed], image: RangeImage, so: str) -> None:
    """Raise SequenceError with all that is bad about recordings for networks that see `image`, `so` being what follows.

    What is worth a look is a MosWarning, once a topic.
    """
    found = [(one.source, finding) for one in recordings for finding in diagnose(one, image)]
    raise_all([f"{source}: {one.topic}: {one.text}" for source, one in found if one.level == "bad"], so)
    warned = [(source, one) for source, one in found if one.level == "warn"]
    for topic in dict.fromkeys(one.topic for _, one in warned):
        (source, first), *others = ((source, one) for source, one in warned if one.topic == topic)
        also = len({other for other, _ in others} - {source})
        more = f" (and the like in {also} more recordings)" if also else ""
        warnings.warn(f"{source}: {topic}: {first.text}{more}", MosWarning, stacklevel=2)
