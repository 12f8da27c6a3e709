"""What a diagnosis took for granted: object, beam, sensor, photons and scan that were modelled, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ..base.geometry import PARALLEL
from ..base.vectors import FLAT
from ..base.words import counted, label
from ..physics.beam.materials import attenuation_per_mm
from ..physics.scenes.labeled import materials_of
from ..physics.scenes.shapes import NOTHING
from ..recordings.recording import Recording
from .preparation import labels_of
from .request import DiagnosisRequest, LabelledObject, ShapesObject
from .residuals.dataset import Prepared
from .scanned_object import shaped_object
from .wording import enumerated


def described(
    asked: DiagnosisRequest, recording: Recording, prepared: Prepared, effects: Sequence[str]
) -> dict[str, str]:
    """What was modelled, for readers.

    Parameters
    ----------
    effects : sequence of str
        That were tried.

    Returns
    -------
    dict of str to str
        {what: a phrase with units}.
    """
    labels, settings = labels_of(recording), asked.settings
    tube = "voltage not stated" if labels.tube_kvp is None else f"{labels.tube_kvp:g} kV stated"
    sensor, kev = labels.sensor, prepared.fitter.model.chain.scene.energy_kev
    (water,) = attenuation_per_mm("water", [kev])
    known = ", ".join(f"{name} {value:g}" for name, value in settings.alignment.items())
    photons = "from the noise" if settings.nominal_photons is None else f"{settings.nominal_photons:g} stated"
    return {
        "object": object_of(asked),
        "scan": scan_section(asked, recording),
        "beam before any effect": f"one energy, {kev:.3g} keV, at which water attenuates {water:.3g} per mm",
        "tube": f"anode of {labels.anode.target} at {labels.anode.angle_deg:g} degrees, {tube}",
        "sensor": f"{label(sensor.material)}, {sensor.thickness_mm:g} mm, reads {sensor.reads}",
        "photons per pixel in air": photons,
        "data": f"{counted(len(recording.repeats), 'repeat')}, {_views_of(prepared.step)}; not fitted: {prepared.held}",
        "rays per pixel and direction": f"{prepared.fitter.model.chain.samples}",
        "alignment, standard deviations stated": known or "none: the defaults",
        "physics declared": ", ".join(map(label, settings.baseline)) or "none",
        "effects tried": ", ".join(map(label, effects)) or "none: physics taken from another recording",
    }


def _views_of(step: int) -> str:
    return "all views" if step == 1 else f"one view of {step} ({100 / step:.2g} % of what the views tell)"


def object_of(asked: DiagnosisRequest) -> str:
    """What was scanned, in words."""
    disc, other = asked.settings.disc, asked.settings.object
    if disc is not None:
        return f"a cylinder along z, {disc.diameter_mm:g} mm across, of {label(disc.material)}"
    if isinstance(other, ShapesObject):
        shaped = shaped_object(other)
        return f"shapes ({shaped.name}): {shaped.description.rstrip('.')}"
    if isinstance(other, LabelledObject):
        of = enumerated([label(one) for one in dict.fromkeys(materials_of(other.materials).values()) if one != NOTHING])
        return f"the label map {Path(other.labels).name}, of {of}"
    if other is not None:
        return f"the homogeneous object of {Path(other.mask).name}, of {label(other.material)}"
    materials = asked.materials
    return (
        f"the study's phantom, each voxel by its HU of {label(materials['soft'])}, and from "
        f"{materials['dense_from_hu']:g} HU on of {label(materials['dense'])} too"
    )


def scan_section(asked: DiagnosisRequest, recording: Recording) -> str:
    """How it was scanned, in words."""
    if asked.protocol is not None:
        scan, views, made = asked.protocol.scan, asked.protocol.projections, f", {asked.protocol.algorithm.upper()}"
    else:
        scan, views, made = recording.scan, recording.scan["views"], ""
    return (
        f"{scan['trajectory']}, {views} views, {scan['rows']} x {scan['columns']} pixels (rows x columns) of "
        f"{scan['row_pitch_mm']:g} x {scan['column_pitch_mm']:g} mm, {_surface(scan)}, {_beam(scan)}{made}"
    )


def _beam(scan: Mapping) -> str:
    if scan.get("beam") == PARALLEL:
        return "parallel beam"
    return (
        f"source to isocentre {scan['source_to_isocentre_mm']:g} mm, to detector {scan['source_to_detector_mm']:g} mm"
    )


def _surface(scan: Mapping) -> str:
    spots = scan.get("flying_focal_spot") or []
    flies = f", focal spot in {len(spots)} places" if spots else ""
    return f"{scan.get('detector', FLAT)} detector{flies}"
