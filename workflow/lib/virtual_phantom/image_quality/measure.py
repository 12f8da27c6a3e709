"""Measurement of all modules of a phantom in one or more recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import ndimage, stats

from ..base.errors import InputError
from ..base.geometry import Grid
from ..image_model.dose import DoseLaw
from ..physics.scenes.objects import read_object
from ..recordings.images import ImagesRecording
from ..recordings.in_plane import fit_circle
from .location import Layout, Location, layout, locate, roll_of_inserts
from .measures import hu_regression, inserts, noise, slice_profile, uniform_area
from .settings import ImageQualitySettings, ModuleSettings
from .uniformity import uniformity

FOUND_SLICE = 0.97  # correlation of nominal HU of inserts with a slice inside the module
SOFT_HU = (-100.0, 200.0)  # smoothed HU of areas that are searched for uniform ones if there is no object
LOCAL_MM = 8.0  # side of the squares whose SD is compared to find uniform areas
UNIFORM = 1.25  # largest local SD of uniform areas, relative to the most frequent one
DOSES = ("dose_mgy", "mas")  # keys of `nominal` and of DICOM facts, in order of preference


@dataclass
class ImageQuality:
    """Result of `measure`.

    Attributes
    ----------
    content : dict
        Content of image_quality.json.
    tables : dict of str to DataFrame
        Tables of all modules and recordings, by file name.
    images : dict of str to tuple of (ndarray, Grid, Location or None)
        Mean of the slices of every module, by "recording, module".
    """

    content: dict
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    images: dict[str, tuple[np.ndarray, Grid, Location | None]] = field(default_factory=dict)


def measure(name: str, settings: ImageQualitySettings, recordings: Mapping[str, ImagesRecording]) -> ImageQuality:
    """Measure the image quality of recordings of a phantom.

    Parameters
    ----------
    recordings : mapping of str to ImagesRecording
        By name.

    Raises
    ------
    InputError
        If a module is not in the images, or is too small to be measured.
    """
    result = ImageQuality({"name": name, "recordings": {}, "noise_against_dose": {}})
    for recording_name, recording in recordings.items():
        facts = recording.provenance.dicom | recording.nominal
        entry = {key: facts.get(key) for key in (*DOSES, "tube_kvp", "kernel", "slice_thickness_mm")}
        entry |= {"voxel_mm": list(recording.grid.spacing), "repeats": len(recording.repeats), "modules": {}}
        volumes = [volume.array for volume in recording.repeats]
        for module, known in settings.modules.items():
            try:
                content, tables, shown = measure_module(volumes, recording.grid, known)
            except InputError as error:
                raise InputError(f"image_quality.{name}: {recording_name}, module {module}: {error}") from None
            entry["modules"][module] = content
            result.images[f"{recording_name}, {module}"] = shown
            for table, rows in tables.items():
                where = {"recording": recording_name, "module": module}
                rows = pd.concat([pd.DataFrame(where, index=rows.index), rows], axis=1)
                known_rows = [result.tables[table]] if table in result.tables else []
                result.tables[table] = pd.concat([*known_rows, rows], ignore_index=True)
        result.content["recordings"][recording_name] = entry
    for module in settings.modules:
        if series := _against_dose(module, result.content["recordings"].values()):
            result.content["noise_against_dose"][module] = series
    return result


def measure_module(volumes: list[np.ndarray], grid: Grid, known: ModuleSettings) -> tuple[dict, dict, tuple]:
    """Measure one module in the repeats of a scan.

    Parameters
    ----------
    volumes : list of ndarray, shape (z, y, x)
        HU, one per repeat.

    Returns
    -------
    content : dict
        As under `modules` of schemas/image_quality.schema.yaml.
    tables : dict of str to DataFrame
        By file name.
    shown : tuple of (ndarray, Grid, Location or None)
        Mean slice and location of the object.

    Raises
    ------
    InputError
        If the module is not in the images, or too small.
    """
    cylinders = None
    if known.object is not None:
        shaped = read_object(known.object.kind, known.object.parameters)
        cylinders = layout(shaped)
    chosen = _slices(volumes[0], grid, known, cylinders)
    images = np.stack([volume[chosen] for volume in volumes]).astype(np.float64)
    mean, spacing = images.mean(axis=0), grid.spacing
    z = grid.centre_mm[2] + grid.axes_mm()[0][chosen]
    content: dict = {"object": known.object and known.object.kind, "z_mm": [float(z[0]), float(z[-1])]}
    content |= {"slices": len(z), "location": None, "inserts": [], "hu": None, "noise": None}
    content |= {"slice_profile": None, "uniformity": None}
    tables: dict[str, pd.DataFrame] = {}
    if cylinders is None:
        area, found = _uniform_areas(mean, spacing), None
    else:
        found = locate(mean, spacing, cylinders)
        content["location"] = _location(found, spacing)
        area = uniform_area(mean, spacing, cylinders, found)
        rows, curves = inserts(mean, spacing, cylinders, found)
        if len(rows):
            content["hu"] = hu_regression(rows, found)
            content["inserts"] = rows.astype(object).where(rows.notna(), None).to_dict("records")
            tables |= {"inserts": rows, "ttf": curves}
        width, profile = slice_profile(mean, spacing, shaped, found)
        if width is not None:
            content["slice_profile"] = {"fwhm_mm": width}
            tables["slice_profile"] = profile
        if not found.inserts:
            content["uniformity"], tables["radial"], tables["angular"] = uniformity(mean, spacing, cylinders, found)
    try:
        content["noise"], tables["noise_spectra"], tables["noise_by_location"] = noise(images, area, spacing)
    except InputError:
        if not tables:  # nothing else is measured
            raise
    shown = Grid((1, *grid.shape[1:]), spacing)
    return content, tables, (mean.mean(axis=0), shown, found)


def _slices(volume: np.ndarray, grid: Grid, known: ModuleSettings, cylinders: Layout | None) -> slice:
    """Return the stated slices; otherwise those in which the inserts are found; otherwise all.

    Raises
    ------
    InputError
        If there are none.
    """
    z = grid.centre_mm[2] + grid.axes_mm()[0]
    if known.z_mm is not None:
        inside = np.flatnonzero((z >= min(known.z_mm)) & (z <= max(known.z_mm)))
        if not len(inside):
            raise InputError(f"z_mm has no slice; slices are at {z[0]:.1f} to {z[-1]:.1f} mm")
        return slice(inside[0], inside[-1] + 1)
    if cylinders is None or not cylinders.inserts:
        return slice(0, len(z))
    matches = np.zeros(len(z), bool)
    for index, plane in enumerate(volume):
        try:
            center = fit_circle(plane, grid.spacing, cylinders.body_radius)
        except InputError:
            continue
        matches[index] = roll_of_inserts(plane, grid.spacing, center[:2], cylinders)[0] >= FOUND_SLICE
    regions, count = ndimage.label(matches)
    if not count:
        raise InputError("its inserts are in no slice; check the object, or state z_mm")
    first, last = np.flatnonzero(regions == np.argmax(np.bincount(regions)[1:]) + 1)[[0, -1]]
    # The slices at both ends may contain the neighboring modules.
    return slice(first + 1, last) if last - first >= 2 else slice(first, last + 1)


def _location(found: Location, spacing) -> dict:
    tilt = found.centers[-1] - found.centers[0]
    length = max(len(found.centers) - 1, 1) * spacing[0]
    center = found.centers.mean(axis=0)
    return {
        "x_mm": float(center[0]),
        "y_mm": float(center[1]),
        "diameter_mm": 2 * found.radius,
        "tilt_deg": float(np.degrees(np.arctan(np.hypot(*tilt) / length))),
        "roll_deg": (found.roll_deg + 180) % 360 - 180,
        "mirrored": found.mirrored,
    }


def _uniform_areas(images: np.ndarray, spacing) -> np.ndarray:
    """Return pixels of soft tissue whose local SD is near the most frequent one (global noise level [1]_).

    Raises
    ------
    InputError
        If there is no soft tissue, or it has no noise.

    References
    ----------
    .. [1] O. Christianson et al., Am. J. Roentgenol. 205, W93, 2015.
    """
    size = max(3, int(round(LOCAL_MM / max(spacing[1:]))))
    local = [ndimage.uniform_filter(part, (0, size, size)) for part in (images, images**2)]
    sd = np.sqrt(np.maximum(local[1] - local[0] ** 2, 0)).max(axis=0)
    soft = ((local[0] > SOFT_HU[0]) & (local[0] < SOFT_HU[1])).all(axis=0)
    if not soft.any():
        raise InputError("there is no soft tissue or water in the image; state the object")
    values = np.log(sd[soft][sd[soft] > 0])
    if len(np.unique(values)) < 2:
        raise InputError("soft tissue has no noise in the image; use an image with noise, or state the object")
    levels = np.linspace(*np.percentile(values, [1, 99]), 200)
    level = np.exp(levels[np.argmax(stats.gaussian_kde(values[:: max(1, len(values) // 5000)])(levels))])
    centers = soft & (sd < UNIFORM * level)
    return ndimage.binary_dilation(centers, np.ones((size, size)))


def _against_dose(module: str, recordings: Iterable[Mapping]) -> dict | None:
    """Return noise by dose, and the exponents of variance against dose; None for fewer than two doses."""
    measured = [one for one in recordings if one["modules"][module]["noise"] is not None]
    for key in DOSES:
        doses = sorted({one[key] for one in measured if one[key]})  # scanners write 0 for an unknown dose
        if len(doses) > 1 and all(one[key] for one in measured):
            squares = [(one[key], one["modules"][module]["noise"]["sd_hu"] ** 2) for one in measured]
            variances = {dose: float(np.mean([square for at, square in squares if at == dose])) for dose in doses}
            return {
                "quantity": key,
                "doses": doses,
                "sd_hu": [float(np.sqrt(variances[dose])) for dose in doses],
                "exponents": list(DoseLaw(variances).exponents().values()),
            }
    return None
