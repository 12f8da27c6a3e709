"""Request for the diagnosis of one recording: its section of the configuration, and the scanner's nominal settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..base.geometry import ImageProtocol
from ..base.settings import to_mapping
from ..physics.beam.materials import Segmentation
from ..physics.beam.sensors import Sensor
from ..physics.beam.spectra import Anode
from .settings import FitSettings, RecordingSettings

LOCATION_DIGITS = 1  # decimals of a fitted object location in mm


@dataclass(frozen=True)
class DiagnosisRequest:
    """All that the diagnosis of one recording depends on, besides the candidate effects.

    Attributes
    ----------
    mu_water_per_mm : float
        Attenuation of water for the monochromatic beam, 1/mm.
    materials : Segmentation
        Conversion of HU to materials.
    phantom : str, Path or None
        Image of the study's phantom, HU; None if `settings` has a disc or an object.
    seed : int
        Seed of the study, for simulated noise.
    protocol : ImageProtocol or None
        None for projections.
    mirrored : bool
        Whether images show an object that is constant along z from its other end: their columns are reversed.
    """

    folder: str | Path
    settings: RecordingSettings
    mu_water_per_mm: float
    materials: Segmentation
    phantom: str | Path | None = None
    seed: int = 0
    protocol: ImageProtocol | None = None
    threads: int = 1
    mirrored: bool = False

    def located(self, location: Mapping[str, float]) -> DiagnosisRequest:
        """Return the request with the object at this location; itself if the location is empty."""
        return replace(self, settings=replace(self.settings, location=dict(location))) if location else self

    @classmethod
    def of(cls, model: FitSettings, phantom: str | Path | None, threads: int) -> DiagnosisRequest:
        """Return the request of a job with these settings."""
        given = vars(model) | {"materials": Segmentation(**to_mapping(model.materials))}
        return cls(**given, phantom=phantom, threads=threads)


@dataclass(frozen=True)
class NominalSettings:
    """Nominal settings of the scanner, from recording.yaml."""

    anode: Anode
    tube_kvp: float | None
    sensor: Sensor
