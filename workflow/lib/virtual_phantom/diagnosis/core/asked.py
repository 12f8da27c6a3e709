"""What the configuration asks of the diagnosis of one recording, and what the recording's labels say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ...physics.sensors import Sensor
from ...physics.spectra import Anode


@dataclass(frozen=True)
class Asked:
    """What the configuration asks.

    Attributes
    ----------
    folder : str or Path
        Of the recording.
    settings : mapping
        diagnosis.recordings.<name>, complete.
    mu_water_per_mm : float
        Of the monochromatic beam, 1/mm.
    materials : mapping
        How HU are divided, as the configuration's section.
    phantom : str, Path or None
        Image of the study's phantom, HU; None where `settings` has a disc or an object.
    seed : int
        Of the study, for simulated noise.
    protocol : mapping or None
        Of images: their scan, projections, grid, algorithm, settings and engine (images.setting.Protocol).
    threads : int
    """

    folder: str | Path
    settings: Mapping
    mu_water_per_mm: float
    materials: Mapping
    phantom: str | Path | None = None
    seed: int = 0
    protocol: Mapping | None = None
    threads: int = 1


@dataclass(frozen=True)
class Labels:
    """What is written on the scanner.

    Attributes
    ----------
    anode : Anode
    tube_kvp : float or None
        kV; None: not known.
    sensor : Sensor
    """

    anode: Anode
    tube_kvp: float | None
    sensor: Sensor
