"""The part of a log between two times."""

from jaxest.io import SensorLog
from jaxest.io.log import where
from jaxest.types import InputError


def windowed(log: SensorLog, start: float | None, end: float | None) -> SensorLog:
    """Cut a log.

    Args:
        log: the log.
        start: s from the first sample of any stream; None for the beginning.
        end: s from the first sample of any stream, inclusive; None for the end.

    Returns:
        The samples in between; a stream without any is left out.

    Raises:
        InputError: the window is empty or holds no sample.
    """
    if start is None and end is None:
        return log
    first = min(float(item.time[0]) for item in log.streams.values())
    last = max(float(item.time[-1]) for item in log.streams.values())
    low = first if start is None else first + start
    high = last if end is None else first + end
    streams = {}
    for name, item in log.streams.items():
        inside = (item.time >= low) & (item.time <= high)
        if inside.any():
            streams[name] = item._replace(time=item.time[inside], value=item.value[inside])
    if not streams:
        raise InputError(
            f"{where(log)}no sample between {low - first:g} and {high - first:g} s; the log lasts {last - first:.3f} s"
        )
    return log._replace(streams=streams)
