"""How differences of a kind of recording are drawn, and in which unit they are summed up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Look:
    """What reports and figures need to know of a kind of recording.

    unit         of differences, as metrics name it
    summed       axis of the data that maps are summed over
    down, across   names of the map's axes
    profiles     (domain, name of its axis, number of its first place)
    one_repeat   where the noise of a recording with a single repeat is from
    """

    unit: str
    summed: int
    down: str
    across: str
    profiles: tuple[tuple[str, str, int], ...]
    one_repeat: str
