"""Request for the diagnosis of one recording: its section of the configuration, and the scanner's nominal settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..base.errors import InputError
from ..base.geometry import ImageProtocol
from ..base.settings import to_mapping
from ..io.volumes import Volume
from ..physics.beam.materials import Segmentation, attenuation_per_mm
from ..physics.beam.sensors import Sensor, sensor_from_label
from ..physics.beam.spectra import KVP, TUNGSTEN, Anode
from ..recordings.recording import Recording
from .settings import FitSettings, MaskedObject, RecordingSettings

LOCATION_DIGITS = 1  # decimals of a fitted object location in mm
# SD of the scale of line integrals if their energy is not known. At 40 and 150 keV, the attenuation of PMMA is 1.22 and
# 0.76 times that at 60 keV.
ASSUMED_ENERGY_SD = 0.3


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
    energy_kev : float or None
        Energy of the monochromatic beam that recording.yaml states, keV; None: the energy of `mu_water_per_mm`, or
        60 keV for a homogeneous object.
    protocol : ImageProtocol or None
        None for projections.
    other_scan : Volume or None
        Another scan in place of an object, HU, at the slices of the recording (images.other_scan).
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
    energy_kev: float | None = None
    mirrored: bool = False
    other_scan: Volume | None = None

    def with_energy(self, nominal: Mapping) -> DiagnosisRequest:
        """Return the request with the energy that `nominal` of recording.yaml states; itself if it states none."""
        energy = nominal.get("energy_kev")
        if energy is None:
            return self
        (water,) = attenuation_per_mm("water", [energy])
        return replace(self, energy_kev=energy, mu_water_per_mm=float(water))

    def alignment(self, nominal: Mapping) -> dict[str, float]:
        """Return the stated priors of line integrals, with a wide one of the scale if the energy of a disc is assumed.

        Parameters
        ----------
        nominal : mapping
            Section of recording.yaml.
        """
        homogeneous = self.settings.disc is not None or isinstance(self.settings.object, MaskedObject)
        assumed = homogeneous and not {"energy_kev", "tube_kvp"} & set(nominal)
        return ({"scale": ASSUMED_ENERGY_SD} if assumed else {}) | self.settings.alignment

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


def nominal_settings(recording: Recording) -> NominalSettings:
    """Return what a recording.yaml states of tube and sensor.

    Raises
    ------
    InputError
        For a nominal anode or tube voltage without a known spectrum.
    """
    nominal = recording.nominal
    anode = Anode(nominal.get("anode", TUNGSTEN.target), nominal.get("anode_angle_deg", TUNGSTEN.angle_deg))
    target, tube_kvp = anode.target, nominal.get("tube_kvp")
    if target not in KVP or (tube_kvp is not None and not KVP[target][0] <= tube_kvp <= KVP[target][1]):
        ranges = ", ".join(f"{name} {low:g} to {high:g} kV" for name, (low, high) in KVP.items())
        raise InputError(
            f"{recording.document.path}: no spectrum is known of nominal.anode {target} at {tube_kvp} kV, only {ranges}"
        )
    return NominalSettings(anode, tube_kvp, sensor_from_label(**nominal.get("sensor", {})))
