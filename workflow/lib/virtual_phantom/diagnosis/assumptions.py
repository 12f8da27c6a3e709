"""Model assumptions in words: object, scan, beam, sensor and photons that a diagnosis takes as given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ..base.geometry import PARALLEL
from ..base.names import counted, enumerated, label
from ..base.settings import to_mapping
from ..base.vectors import FLAT
from ..physics.beam.materials import attenuation_per_mm
from ..physics.scenes.labeled import label_materials
from ..physics.scenes.shapes import NOTHING
from ..recordings.recording import Recording
from .images.scan import ASSUMED
from .projections.object_errors import DENSE_HU, DENSITY, SURFACE, ObjectErrors
from .request import DiagnosisRequest, nominal_settings
from .residuals.dataset import Prepared
from .scanned_object import shaped_object
from .settings import LabelledObject, OtherScan, RecordingSettings, ShapesObject

OF_WATER = (
    "It gives one path length in water per ray. Beam hardening by bone, metal or a K edge is therefore not "
    "distinguished from the spectrum; path lengths in these materials would distinguish it. "
)
OF_PROJECTIONS = (
    "Other rays are interpolated, which is approximate at sharp edges. The object is continued beyond the outermost "
    "rows and columns."
)
OF_IMAGES = (
    "Its mean slice is also the object, constant along z, whose images change with effects on raw data. Its noise and "
    "errors remain in the model."
)


OF_SCAN = (
    "The mean of every second slice, or fewer, is also the object, constant along z, whose images change with effects. "
    "Both scans are compared in the slices between. Physics that both scans share is not found."
)


def model_assumptions(
    request: DiagnosisRequest, recording: Recording, prepared: Prepared, effects: Sequence[str]
) -> dict[str, str]:
    """Return section `modelled` of diagnosis.json: {subject: a phrase with units}."""
    nominal, settings = nominal_settings(recording), request.settings
    tube = "voltage not stated" if nominal.tube_kvp is None else f"{nominal.tube_kvp:g} kV stated"
    sensor, kev = nominal.sensor, prepared.fitter.model.chain.scene.energy_kev
    (water,) = attenuation_per_mm("water", [kev])
    wide = recording.kind == "projections" and request.alignment(recording.nominal) != settings.alignment
    assumed = "; not stated, so the scale of line integrals is fitted" if wide else ""
    stated_priors = ", ".join(f"{name} {value:g}" for name, value in settings.alignment.items())
    stated = settings.nominal_photons
    if stated is None and recording.kind == "projections":
        stated = recording.nominal.get("photons")
    photons = "from the noise" if stated is None else f"{stated:g} stated"
    simulation = {}
    if settings.of_scan:
        simulation["limits of the other scan"] = OF_SCAN
    if settings.simulation is not None:
        scene = prepared.fitter.model.chain.scene
        of_projections = (OF_WATER if scene.materials == ("water",) else "") + OF_PROJECTIONS
        simulation["limits of the simulation"] = of_projections if recording.kind == "projections" else OF_IMAGES
    return simulation | {
        "object": object_text(request),
        "uncertainty of the object": uncertainty_text(settings, prepared.fitter.model.object_errors),
        "scan": scan_text(request, recording),
        "beam before any effect": f"one energy, {kev:.3g} keV, at which water attenuates {water:.3g} per mm{assumed}",
        "tube": f"anode of {nominal.anode.target} at {nominal.anode.angle_deg:g} degrees, {tube}",
        "sensor": f"{label(sensor.material)}, {sensor.thickness_mm:g} mm, reads {sensor.reads}",
        "photons per pixel in air": photons,
        "data": f"{counted(len(recording.repeats), 'repeat')}, {_compared(request, prepared)}; held out: "
        f"{prepared.held_out_text}",
        "rays per pixel and direction": f"{prepared.fitter.model.chain.samples}",
        "alignment, standard deviations stated": stated_priors or "none: the defaults",
        "physics declared": ", ".join(map(label, settings.baseline)) or "none",
        "effects tried": ", ".join(map(label, effects)) or "none",
    }


def _compared(request: DiagnosisRequest, prepared: Prepared) -> str:
    """Return the compared views, or the voxels of images, in words."""
    if request.protocol is None:
        return _views(prepared.step)
    _, y_mm, x_mm = prepared.fitter.model.spacing_mm
    text = " x ".join(map(str, prepared.data.mean.shape))
    text += f" voxels (z, y, x) of {y_mm:.3g} x {x_mm:.3g} mm in the plane"
    slices = prepared.data.n + prepared.held_out.n
    return text if prepared.fitter.model.recorded_noise is None else f"{text}, {slices} slices as its repeats"


def _views(step: int) -> str:
    return "all views" if step == 1 else f"one of {step} views ({100 / step:.2g} % of the data)"


def object_text(request: DiagnosisRequest) -> str:
    """Return the scanned object in words."""
    disc, other = request.settings.disc, request.settings.object
    if disc is not None:
        return f"a cylinder along z, {disc.diameter_mm:g} mm across, of {label(disc.material)}"
    if isinstance(other, ShapesObject):
        shaped = shaped_object(other)
        return f"shapes ({shaped.name}): {shaped.description.rstrip('.')}"
    if isinstance(other, LabelledObject):
        materials = dict.fromkeys(label_materials(other.materials).values())
        of = enumerated([label(material) for material in materials if material != NOTHING])
        return f"the label map {Path(other.labels).name}, of {of}"
    if request.settings.simulation is not None:
        of = "a slice" if request.protocol is not None else "path lengths"
        return f"the simulation {Path(request.settings.simulation).name}, as {of}"
    if isinstance(other, OtherScan):
        return f"another scan, {Path(other.scan).name}, as a slice"
    if other is not None:
        return f"the homogeneous object of {Path(other.mask).name}, of {label(other.material)}"
    materials = request.materials
    return (
        f"the study's phantom: {label(materials.soft)} scaled by the HU of each voxel, with "
        f"{label(materials.dense)} from {materials.dense_from_hu:g} HU"
    )


def uncertainty_text(settings: RecordingSettings, errors: ObjectErrors) -> str:
    """Return the standard deviations of the fitted errors of the object, in words."""
    if settings.object_exact:
        return "none: stated as exact"
    uncertainty, found = settings.object_uncertainty, []
    sds = {number.name: number.sd for number in errors.numbers}
    if sds and settings.of_phantom:
        found = [f"{uncertainty.hu:g} HU", f"{100 * uncertainty.density:g} % of the density above {DENSE_HU} HU"]
    elif sds:
        densities = {name: sd for name, sd in sds.items() if name.startswith(DENSITY)}
        found = [f"density of {label(name.removeprefix(DENSITY))} {100 * sd:g} %" for name, sd in densities.items()]
    surfaces = [sd for name, sd in sds.items() if name.startswith(SURFACE)]
    if surfaces:
        found.append(f"surfaces {max(surfaces):.2g} mm")
    if errors.edges is not None:
        found.append("edges within voxels")
    return ", ".join(found) or "density scale and size alone"


def scan_text(request: DiagnosisRequest, recording: Recording) -> str:
    """Return the scan geometry, and the reconstruction of images, in words."""
    if request.protocol is not None:
        scan, views = to_mapping(request.protocol.scan), request.protocol.projections
        reconstruction = f", {request.protocol.algorithm.upper()}"
        assumed = [] if request.settings.of_phantom else [key for key in ASSUMED if key not in recording.scan]
        if assumed:
            reconstruction += f"; not stated, so assumed: {', '.join(assumed)}; center of the images at the isocenter"
    else:
        scan, views, reconstruction = recording.scan, recording.scan["views"], ""
    sides = f"{scan['row_pitch_mm']:g} x {scan['column_pitch_mm']:g} {scan.get('length_unit', 'mm')}"
    return (
        f"{scan['trajectory']}, {views} views, {scan['rows']} x {scan['columns']} pixels (rows x columns) of {sides}, "
        f"{_detector(scan)}, {_beam(scan)}{reconstruction}"
    )


def _beam(scan: Mapping) -> str:
    if scan.get("beam") == PARALLEL:
        return "parallel beam"
    unit = scan.get("length_unit", "mm")
    distances = f"{scan['source_to_isocentre_mm']:g} {unit}", f"{scan['source_to_detector_mm']:g} {unit}"
    return f"source to isocenter {distances[0]}, to detector {distances[1]}"


def _detector(scan: Mapping) -> str:
    spots = scan.get("flying_focal_spot") or []
    flying = f", focal spot in {len(spots)} places" if spots else ""
    return f"{scan.get('detector', FLAT)} detector{flying}"
