"""Scan that simulates images of a known object: what recording.yaml states, and defaults for what it does not.

An object that is constant along z is simulated as one slice in a fan beam. The slices of its images are then repeats of
this slice, and their differences show the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...base.errors import InputError
from ...base.geometry import Grid, ImageProtocol
from ...base.settings import FbpSettings, FocalSpot, GridSettings, KernelSettings, ScanSettings
from ...base.vectors import CYLINDRICAL, FLAT
from ...physics.beam.materials import energy_of
from ...physics.scenes.prism import PrismScene
from ...physics.scenes.shapes import DiscScene, is_constant_along_z
from ...recordings.images import ImagesRecording
from ..request import DiagnosisRequest
from ..scanned_object import scene_of, shaped_object, shown_slices
from ..settings import ShapesObject

DISTANCES_MM = (595.0, 1085.6)  # source to isocenter and detector of a clinical scanner, if nothing is stated
PANEL_RATIO = 1.5  # source to detector over source to isocenter of cone-beam CT on linear accelerators
PANEL_FROM_MM = 1200.0  # clinical gantries have shorter distances from source to detector
MOST_ACROSS = 192  # voxels across the object, of images that are compared; finer ones are averaged
# Distance of detector pixels at the isocenter over the voxel size. Their width, and the interpolation between them when
# rays are rebinned, then blur as much as the average over a voxel: w^2/12 = p^2/12 + p^2/6.
PIXEL_OVER_VOXEL = 1 / math.sqrt(3)
VIEW_OVER_VOXEL = 0.8  # distance between views at the edge of the object, over the voxel size
# MTF of the reconstruction over the Nyquist frequency of the rays. Blur is left to the effects.
MTF50, MTF10 = 0.9, 1.1
MARGIN_MM = 10.0  # around the object, for its edge and the air next to it
ROTATION_MS = 1000.0  # assumed time of a rotation; effects in time are only tried if it is stated


@dataclass(frozen=True)
class ImagedObject:
    """Object of a recording of images, and its slices.

    Attributes
    ----------
    slices : slice
        Slices of the recording that show the object.
    prism : bool
        Whether the object is constant along z.
    binned : int
        Voxels of the recording along x and y that are averaged, so that at most MOST_ACROSS voxels are across.
    window : tuple of 2 slice
        Rows and columns that hold the object and its surroundings, symmetric about the middle.
    """

    slices: slice
    prism: bool
    radius_mm: float
    binned: int
    window: tuple[slice, slice]


def imaged_object(request: DiagnosisRequest, grid: Grid) -> ImagedObject:
    """Return the imaged object of a request, for a recording on this grid.

    Raises
    ------
    InputError
        If the stated slices do not exist, or the file of the object is missing or invalid.
    """
    stated, count = request.settings.slices, grid.shape[0]
    if stated is not None and not 0 <= stated[0] <= stated[1] < count:
        raise InputError(
            f"diagnosis.recordings: slices {list(stated)} are not in the images, which have slices 0 to {count - 1}; "
            "give the first and the last slice that show the object"
        )
    slices = shown_slices(stated, count)
    scanned, scene = request.settings.object, scene_of(request)
    if isinstance(scanned, ShapesObject):
        prism = is_constant_along_z(shaped_object(scanned).shapes)
    else:
        prism = isinstance(scene, DiscScene | PrismScene)
    radius = scene.radius_mm
    halves = [
        math.ceil((radius + MARGIN_MM + abs(request.settings.location.get(axis, 0.0))) / step)
        for axis, step in zip(("y_mm", "x_mm"), grid.spacing[1:], strict=True)
    ]
    binned = max(1, math.ceil(2 * max(halves) / MOST_ACROSS))
    if binned % 2 == 0 and any(side % 2 for side in grid.shape[1:]):
        binned += 1
    window = tuple(_symmetric(side, half, binned) for side, half in zip(grid.shape[1:], halves, strict=True))
    return ImagedObject(slices, prism, radius, binned, window)


def _symmetric(count: int, half: int, binned: int) -> slice:
    """Return the middle of `count` positions, at least 2 x `half` of them if there are as many, in multiples."""
    away = max(0, count // 2 - half)
    while away and (count - 2 * away) % binned:
        away -= 1
    while (count - 2 * away) % binned:
        away += 1
    return slice(away, count - away)


def scan_of_images(recording: ImagesRecording, request: DiagnosisRequest) -> ImageProtocol:
    """Return the scan and reconstruction that simulate images of an object.

    Raises
    ------
    InputError
        See `imaged_object`.
    """
    grid = recording.grid
    imaged = imaged_object(request, grid)
    away = math.hypot(*(request.settings.location.get(axis, 0.0) for axis in ("x_mm", "y_mm")))
    radius = imaged.radius_mm + away + 2 * MARGIN_MM
    scan = dict(recording.scan)
    to_detector = scan.get("source_to_detector_mm")
    if to_detector is None:
        to_detector = scan.get("source_to_isocentre_mm", DISTANCES_MM[0]) * DISTANCES_MM[1] / DISTANCES_MM[0]
    panel = to_detector > PANEL_FROM_MM
    ratio = PANEL_RATIO if panel else DISTANCES_MM[1] / DISTANCES_MM[0]
    to_isocentre = scan.setdefault("source_to_isocentre_mm", to_detector / ratio)
    scan.setdefault("source_to_detector_mm", to_detector)
    voxel = grid.spacing[1] * imaged.binned
    enlarged = scan["source_to_detector_mm"] / to_isocentre
    scan.setdefault("detector", FLAT if panel or scan.get("trajectory") == "circular" else CYLINDRICAL)
    scan.setdefault("column_pitch_mm", PIXEL_OVER_VOXEL * voxel * enlarged)
    half_fan = math.asin(min(0.99, radius / to_isocentre))
    half = half_fan if scan["detector"] == CYLINDRICAL else math.tan(half_fan)
    scan.setdefault("columns", 2 * math.ceil(half * scan["source_to_detector_mm"] / scan["column_pitch_mm"]))
    scan.setdefault("row_pitch_mm", grid.spacing[0] * enlarged)
    height = (imaged.slices.stop - imaged.slices.start + 2) * grid.spacing[0]
    rows = math.ceil(height * (1 + imaged.radius_mm / to_isocentre) * enlarged / scan["row_pitch_mm"])
    scan.setdefault("rows", rows)
    scan.setdefault(
        "views_per_rotation", scan.get("views", 2 * math.ceil(math.pi * imaged.radius_mm / (VIEW_OVER_VOXEL * voxel)))
    )
    scan.setdefault("rotation_time_ms", ROTATION_MS)
    if imaged.prism:
        scan["rows"], scan["trajectory"] = 1, "circular"
    spots = tuple(FocalSpot(**{key: spot.get(key, 0.0) for key in SPOT}) for spot in scan.get("flying_focal_spot", ()))
    settings = ScanSettings(
        trajectory=scan.get("trajectory", "circular"),
        pitch=recording.nominal.get("pitch", 1.0),
        turns=None,
        start_angle_deg=scan.get("start_angle_deg", 0.0),
        rotation_time_ms=scan["rotation_time_ms"],
        beam=scan.get("beam", "divergent"),
        arc_radius_mm=scan.get("arc_radius_mm"),
        flying_focal_spot=spots or None,
        column_offset_px=scan.get("column_offset_px", 0.0),
        row_offset_px=0.0,
        **{key: scan[key] for key in COPIED},
    )
    views = round(scan["views_per_rotation"])
    return ImageProtocol(
        settings,
        GridSettings((1, *grid.shape[1:]) if imaged.prism else grid.shape, grid.spacing, oversampling=1),
        projections=views,
        algorithm="fbp",
        settings=_sharp(scan["column_pitch_mm"] / enlarged),
        engine="cpu",
    )


def _sharp(pitch_mm: float) -> FbpSettings:
    """Return a reconstruction that blurs no more than detector pixels with this distance at the isocenter."""
    nyquist_per_cm = 10 / (2 * pitch_mm)
    return FbpSettings("coverage", KernelSettings(MTF50 * nyquist_per_cm, MTF10 * nyquist_per_cm))


def finer_scan(protocol: ImageProtocol, factor: int) -> ImageProtocol:
    """Return the scan with more and smaller detector pixels, and more views."""
    scan = protocol.scan
    pitch = scan.column_pitch_mm / factor
    finer = replace(
        scan, columns=scan.columns * factor, column_pitch_mm=pitch, column_offset_px=scan.column_offset_px * factor
    )
    settings = _sharp(pitch * scan.source_to_isocentre_mm / scan.source_to_detector_mm)
    return replace(protocol, scan=finer, projections=protocol.projections * factor, settings=settings)


def with_scan(request: DiagnosisRequest, recording: ImagesRecording) -> DiagnosisRequest:
    """Return the request with the scan that simulates the images; itself if it has a protocol."""
    if request.protocol is not None:
        return request
    energy = request.energy_kev or energy_of("water", request.mu_water_per_mm)  # at which water has 0 HU
    return replace(request, protocol=scan_of_images(recording, request), energy_kev=energy)


COPIED = (
    "source_to_isocentre_mm",
    "source_to_detector_mm",
    "detector",
    "columns",
    "rows",
    "column_pitch_mm",
    "row_pitch_mm",
)
ASSUMED = ("source_to_isocentre_mm", "source_to_detector_mm", "detector", "columns", "column_pitch_mm", "views")
SPOT = ("columns_mm", "radius_mm", "z_mm")
