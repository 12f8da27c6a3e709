"""How differences of a kind of recording are drawn, and in which unit they are summed up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ResidualMaps:
    """What reports and figures need to know of a kind of recording.

    Attributes
    ----------
    unit : str
        Of differences, as metrics name it.
    summed : int
        Axis of the data that maps are summed over.
    down, across : str
        Names of the map's axes.
    profiles : tuple of tuple of (str, str, int)
        Domain, name of its axis, and number of its first place.
    one_repeat : str
        Where the noise of a recording with a single repeat is from.
    ranked : bool
        Whether further recordings of the kind are ranked by what they would tell (diagnosis.next_measurement).
    """

    unit: str
    summed: int
    down: str
    across: str
    profiles: tuple[tuple[str, str, int], ...]
    one_repeat: str
    ranked: bool = False
