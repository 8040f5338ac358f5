"""A place in a store of objects: `s3://BUCKET/KEY`."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from runtime.errors import SettingError
from runtime.recordings import searching

SCHEME = "s3://"


@dataclass(frozen=True)
class Remote:
    """A recording, or a folder of results."""

    url: str
    is_file: bool = False

    @property
    def key(self) -> PurePosixPath:
        """Bucket and key."""
        return PurePosixPath(self.url.removeprefix(SCHEME))

    def __str__(self) -> str:
        return self.url


Place = Path | Remote


def place_of(text: str) -> Place:
    """Where a text leads. Raises SettingError for stores that are not known, and where a URL holds a password."""
    if "://" not in text:
        return Path(text)
    if not text.startswith(SCHEME) or not text.removeprefix(SCHEME).strip("/"):
        raise SettingError(f"{text.split('://')[0]}://...: recordings are in files or at {SCHEME}BUCKET/KEY")
    if "@" in text.removeprefix(SCHEME).split("/")[0]:
        raise SettingError(f"{SCHEME}...@...: keys and passwords are not for addresses; see the README")
    return Remote(text.rstrip("/"))


def name_of(place: Place) -> str:
    """The name that the recording at a place will have."""
    if isinstance(place, Path):
        return searching.name_of(place)
    return place.key.stem if place.is_file else place.key.name
