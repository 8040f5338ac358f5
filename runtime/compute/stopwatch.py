"""The time that the steps of a call take."""

from time import perf_counter


class Stopwatch:
    """Runs from its making on."""

    def __init__(self) -> None:
        self._started = self._last = perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """The step `name` ends here."""
        now = perf_counter()
        self._laps[name] = now - self._last
        self._last = now

    def timing(self) -> dict[str, float]:
        """Seconds of every step, and of all together as "total"."""
        return {**self._laps, "total": self._last - self._started}
