"""Resolution, noise and HU of one module of a phantom after AAPM Report 233 [1]_.

Standard errors are from the jackknife over blocks of neighboring slices.

References
----------
.. [1] AAPM Report 233, Performance Evaluation of Computed Tomography Systems, 2019; E. Samei et al., Med. Phys. 46,
   e735, 2019.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from scipy import ndimage, stats
from scipy.special import j0

from ..base.errors import InputError
from ..physics.scenes.objects import ShapedObject
from ..physics.scenes.shapes import Shape
from ..recordings.in_plane import around, at
from ..statistics.image_quality import mean_frequency, noise_contrasts, tile_spectrum, tiles
from ..statistics.jackknife import standard_error
from ..statistics.resolution import EdgeBins, EdgeMtf, first_below
from .location import NOISE_MARGIN_MM, REFERENCE_KEV, Insert, Layout, Location, along_z, nominal_hu, turned

LEAST_INSERT_VOXELS = 6.0  # radius of an insert, in voxels, from which HU and TTF are measured
WIRE_VOXELS = 0.75  # largest radius of a wire, in voxels
HU_MARGIN_VOXELS = 3.0  # voxels at the edge of an insert that do not count for its HU
EDGE_HALF, EDGE_FLAT = 0.75, 0.5  # half-widths of the window around an edge and of its flat part, in insert radii
MOST_BLOCKS = 8  # blocks of slices of the jackknife
ENERGIES_KEV = np.arange(40.0, 120.5, 0.5)
LEAST_SLICES = 3  # for noise between slices and along z
LEAST_MATERIALS = 3  # for the regression of HU
SD_TO_MEDIAN = 0.6745  # median of the absolute value of a Gaussian variable of SD 1
STRUCTURE_MM, STRUCTURE_SD = 10.0, 6.0  # side of the median filter that shows unlisted structure, and its smallest SD
THIN_MM = 3.0  # largest diameter of beads and ramps that show the slice profile
PROFILE_MM = 15.0  # half-length of sampled slice profiles


def inserts(
    images: np.ndarray, spacing: Sequence[float], known: Layout, found: Location
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Measure HU and task transfer function (TTF) of every insert.

    Parameters
    ----------
    images : ndarray, shape (z, y, x)
        HU.
    spacing : sequence of 3 float
        mm (z, y, x).

    Returns
    -------
    table : DataFrame
        One row per insert or wire: insert, material, nominal_hu, hu, hu_error, sd_hu, contrast_hu, f50_per_mm,
        f50_error, f10_per_mm. Frequencies are NaN if the TTF does not fall as far. A wire has no HU.
    curves : DataFrame
        Columns insert, frequency_per_mm, ttf.
    """
    pixel = max(spacing[1:])
    rows, curves = [], []
    for one in found.inserts:
        thin = one.radius <= WIRE_VOXELS * pixel
        if not thin and one.radius < LEAST_INSERT_VOXELS * pixel:
            continue
        distance = _distances(images.shape, spacing, found, one)
        row = {"insert": one.name, "material": str(one.material), "nominal_hu": nominal_hu(one.material)}
        response = _wire(images, distance, pixel) if thin else _edge(images, distance, pixel, spacing, found, one)
        inside = distance < (pixel if thin else one.radius - HU_MARGIN_VOXELS * pixel)
        ring = (distance > 1.4 * one.radius) & (distance < 1.8 * one.radius + 4 * pixel * thin)
        hu, error = jackknife(images, lambda kept, inside=inside: float(images[kept][inside[kept]].mean()))
        row |= {
            "hu": np.nan if thin else hu,
            "hu_error": np.nan if thin else error,
            "sd_hu": float(images[inside].std()),
        }
        row["contrast_hu"] = hu - float(images[ring].mean())
        row["f50_per_mm"], row["f50_error"] = jackknife(
            images, lambda kept, response=response: _at_level(*response(kept), 0.5)
        )
        frequency, transfer = response(slice(None))
        row["f10_per_mm"] = _at_level(frequency, transfer, 0.1)
        shown = frequency <= 1 / (2 * pixel)
        curves.append(pd.DataFrame({"insert": one.name, "frequency_per_mm": frequency[shown], "ttf": transfer[shown]}))
        rows.append(row)
    return pd.DataFrame(rows), pd.concat(curves) if curves else pd.DataFrame()


def _edge(images, distance, pixel, spacing, found: Location, one: Insert) -> Callable:
    """Return a function from slices to frequency and TTF of the edge of an insert."""
    half, flat = EDGE_HALF * one.radius, EDGE_FLAT * one.radius
    valid = np.ones(images.shape, bool)
    for other in found.inserts:
        if other != one:
            valid &= _distances(images.shape, spacing, found, other) > other.radius + pixel

    def response(kept):
        bins = EdgeBins(distance[kept] - one.radius, valid[kept], pixel, half)
        mtf = EdgeMtf(bins.means((distance[kept] - one.radius)[bins.near]), bins.step, half, flat)
        return mtf.frequency, mtf.mtf(bins.means(images[kept][bins.near]))

    return response


def _wire(images, distance, pixel) -> Callable:
    """Return a function from slices to frequency and MTF of a wire: Hankel transform of its response."""
    frequency = np.linspace(0, 1 / pixel, 200)

    def response(kept):
        near, ring = (distance[kept] < 8 * pixel), (distance[kept] > 8 * pixel) & (distance[kept] < 12 * pixel)
        values = images[kept][near] - np.median(images[kept][ring])
        transfer = np.abs([(values * j0(2 * np.pi * f * distance[kept][near])).sum() for f in frequency])
        return frequency, transfer / transfer[0]

    return response


def _at_level(frequency: np.ndarray, transfer: np.ndarray, level: float) -> float:
    try:
        return first_below(frequency, transfer, level)
    except InputError:
        return np.nan


def _distances(shape: Sequence[int], spacing: Sequence[float], found: Location, one: Insert) -> np.ndarray:
    """Distance of all voxels (z, y, x) from the axis of an insert, mm."""
    return np.stack([around(shape[1:], spacing, (x + one.x, y + one.y))[2] for x, y in found.centers])


def jackknife(images: np.ndarray, statistic: Callable[[np.ndarray | slice], float]) -> tuple[float, float]:
    """Return a statistic of the slices that it gets by index, and its standard error; NaN for fewer than 3 slices."""
    value = statistic(slice(None))
    if len(images) < 3:
        return value, np.nan
    blocks = np.array_split(np.arange(len(images)), min(MOST_BLOCKS, len(images)))
    without = [statistic(np.setdiff1d(np.arange(len(images)), block)) for block in blocks]
    return value, float(standard_error(np.array(without)))


def hu_regression(table: pd.DataFrame, found: Location) -> dict | None:
    """Fit measured HU by a line of nominal HU, at the energy of the nominal HU that fits best.

    Returns
    -------
    dict or None
        energy_kev, energy_fitted (otherwise the misfit has no minimum in ENERGIES_KEV, and REFERENCE_KEV is used),
        slope, intercept_hu, correlation, rms_hu (of the residuals), nominal_hu (by insert). None for fewer than
        LEAST_MATERIALS materials.
    """
    table = table.dropna(subset="hu")
    if table["material"].nunique() < LEAST_MATERIALS:
        return None
    materials = {one.name: one.material for one in found.inserts}

    def line(energy: float) -> dict:
        nominal = np.array([nominal_hu(materials[name], energy) for name in table["insert"]])
        fit = stats.linregress(nominal, table["hu"])
        residuals = table["hu"] - fit.intercept - fit.slope * nominal
        return {
            "energy_kev": float(energy),
            "slope": float(fit.slope),
            "intercept_hu": float(fit.intercept),
            "correlation": float(fit.rvalue),
            "rms_hu": float(np.sqrt((residuals**2).mean())),
            "nominal_hu": dict(zip(table["insert"], nominal.tolist(), strict=True)),
        }

    best = min((line(energy) for energy in ENERGIES_KEV), key=lambda fit: fit["rms_hu"])
    fitted = ENERGIES_KEV[0] < best["energy_kev"] < ENERGIES_KEV[-1]
    return (best if fitted else line(REFERENCE_KEV)) | {"energy_fitted": bool(fitted)}


def uniform_area(images: np.ndarray, spacing: Sequence[float], known: Layout, found: Location) -> np.ndarray:
    """Return the pixels (y, x) of the medium in all slices, away from its border, inserts and unlisted structure.

    Structure that the object does not list, such as ramps, is found as deviations of the mean image from its median
    filter.
    """
    axis = Insert("", "", 0.0, 0.0, 0.0)
    mask = _distances(images.shape, spacing, found, axis) < known.medium_radius - NOISE_MARGIN_MM
    for one in found.inserts:
        mask &= _distances(images.shape, spacing, found, one) > one.radius + NOISE_MARGIN_MM
    area = mask.all(axis=0)
    mean, size = images.mean(axis=0), int(STRUCTURE_MM / max(spacing[1:]))
    away = np.abs(ndimage.gaussian_filter(mean, 1) - ndimage.median_filter(mean, size))
    structure = away > STRUCTURE_SD * np.median(away[area]) / SD_TO_MEDIAN
    return area & ~ndimage.binary_dilation(structure, iterations=size // 4)


def noise(images: np.ndarray, area: np.ndarray, spacing: Sequence[float]) -> tuple[dict, pd.DataFrame, pd.DataFrame]:
    """Measure noise magnitude, noise power spectra in the plane and along z, and noise by location.

    With several repeats, noise is measured between them. In a single scan, a polynomial of second order is removed from
    each tile; then structure such as rings counts as noise. Differences of slices do not contain it.

    Parameters
    ----------
    images : ndarray, shape (repeats, z, y, x)
        HU.
    area : ndarray of bool, shape (y, x)
        Uniform area.

    Returns
    -------
    content : dict
        sd_hu, sd_error, peak_per_mm and mean_per_mm (frequencies of the in-plane spectrum), tile_mm,
        sd_between_slices_hu, correlation_of_slices; the last two are None for few slices.
    spectra : DataFrame
        Columns kind ("in plane", "between slices", "along z"), frequency_per_mm, power (HU^2 mm^2; along z: HU^2 mm).
    by_location : DataFrame
        One row per tile: x_mm, y_mm (from the center of the image), sd_hu, mean_per_mm.

    Raises
    ------
    InputError
        If the area is too small.
    """
    single, slices = len(images) == 1, images.shape[1]
    side, corners = tiles(area[None])
    corners = [(y, x) for _, y, x in corners]
    values = images if single else noise_contrasts(images)
    squares = _squares(values, corners, side, single)
    variances = (squares**2).mean(axis=(0, 2, 3))
    spectrum = tile_spectrum(squares.reshape(-1, side, side), spacing)
    sd = float(np.sqrt(variances.mean()))
    content = {
        "sd_hu": sd,
        "sd_error": float(variances.std(ddof=1) / np.sqrt(len(variances)) / (2 * sd)),
        "peak_per_mm": float(spectrum.frequency[np.argmax(spectrum.power)]),
        "mean_per_mm": mean_frequency(spectrum).value,
        "tile_mm": side * max(spacing[1:]),
        "sd_between_slices_hu": None,
        "correlation_of_slices": None,
    }
    spectra = [_curve("in plane", spectrum.frequency, spectrum.power)]
    if slices >= LEAST_SLICES:
        apart = _squares(noise_contrasts(images[0][:, None]).swapaxes(0, 1), corners, side, True)
        content["sd_between_slices_hu"] = float(np.sqrt((apart**2).mean()))
        between = tile_spectrum(apart.reshape(-1, side, side), spacing)
        spectra.append(_curve("between slices", between.frequency, between.power))
        columns = values[:, :, area]
        if single:
            columns = columns - columns.mean(axis=1, keepdims=True)
        rho = float((columns[:, 1:] * columns[:, :-1]).mean() / (columns**2).mean())
        if single:  # undo the effect of the subtracted mean, if only neighboring slices are correlated
            rho = (rho * (slices - 1) + 1) / (slices - 2 * (slices - 1) / slices * (1 - rho))
        content["correlation_of_slices"] = rho
        power = (np.abs(np.fft.rfft(columns, axis=1)) ** 2).mean(axis=(0, 2)) * spacing[0] / slices
        spectra.append(_curve("along z", np.fft.rfftfreq(slices, spacing[0])[1:], power[1:]))
    by_location = []
    middle = [(n - side) / 2 for n in area.shape]
    for index, (y, x) in enumerate(corners):
        local = squares.reshape(-1, slices, len(corners), side, side)[:, :, index]
        where = {"x_mm": (x - middle[1]) * spacing[2], "y_mm": (y - middle[0]) * spacing[1]}
        mean = mean_frequency(tile_spectrum(local.reshape(-1, side, side), spacing)).value
        by_location.append(where | {"sd_hu": float(np.sqrt((local**2).mean())), "mean_per_mm": mean})
    return content, pd.concat(spectra), pd.DataFrame(by_location)


def _squares(images: np.ndarray, corners: Sequence, side: int, detrended: bool) -> np.ndarray:
    """Return tiles of images (n, z, y, x), shape (n, z * tiles, side, side), of mean 0 or without a polynomial."""
    squares = np.stack([images[:, :, y : y + side, x : x + side] for y, x in corners], axis=2).astype(np.float64)
    flat = squares.reshape(len(images), -1, side**2)
    t = np.linspace(-1, 1, side)
    y, x = (part.ravel() for part in np.meshgrid(t, t, indexing="ij"))
    terms = [np.ones(side**2), *([x, y, x * y, x**2, y**2] if detrended else [])]
    basis = np.linalg.qr(np.column_stack(terms))[0]
    flat = (flat - (flat @ basis) @ basis.T) * np.sqrt(side**2 / (side**2 - len(terms)))
    return flat.reshape(len(images), -1, side, side)


def _curve(kind: str, frequency: np.ndarray, power: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"kind": kind, "frequency_per_mm": frequency, "power": power})


def slice_profile(
    images: np.ndarray, spacing: Sequence[float], shaped: ShapedObject, found: Location
) -> tuple[float | None, pd.DataFrame]:
    """Measure the slice sensitivity profile from thin cylinders that are tilted against z (ramps), or from beads.

    Returns
    -------
    fwhm_mm : float or None
        Full width at half maximum; None if the object has no ramp or bead.
    curve : DataFrame
        Columns z_mm, profile (maximum 1).

    Raises
    ------
    InputError
        If the profile is wider than PROFILE_MM.
    """
    z = np.arange(-PROFILE_MM, PROFILE_MM + 1e-9, spacing[0] / 20)
    profiles = []
    for shape in shaped.shapes:
        ends = shape.planes[:, :3]
        if shape.quadric is None or along_z(shape):
            continue
        center = -np.linalg.pinv(shape.quadric[:3, :3]) @ shape.quadric[:3, 3]
        if not len(ends):
            if 2 * shape.around[2] <= THIN_MM:
                profiles += _bead(images, spacing, found, center, z)
        elif abs(ends[0, 2]) > 1e-3 and _diameter(shape, center) <= THIN_MM:
            middle = center + ends[0] * (shape.planes[0, 3] - shape.planes[1, 3]) / 2
            length = shape.planes[:, 3].sum()
            profiles += _ramp(images, spacing, found, middle, ends[0], length, z)
    if not profiles:
        return None, pd.DataFrame()
    profile = np.mean(profiles, axis=0)
    profile = profile / profile.max()
    above = np.flatnonzero(profile >= 0.5)
    first, last = above[0], above[-1]
    if first == 0 or last == len(z) - 1:
        raise InputError("slice profile: wider than the sampled range; check the ramps of the object")
    width = z[last] - z[first]
    width += (z[1] - z[0]) * (profile[last] - 0.5) / (profile[last] - profile[last + 1])
    width += (z[1] - z[0]) * (profile[first] - 0.5) / (profile[first] - profile[first - 1])
    return float(width), pd.DataFrame({"z_mm": z, "profile": profile})


def _diameter(shape: Shape, center: np.ndarray) -> float:
    point = np.append(center, 1.0)
    return 2 * float(np.sqrt(max(-(point @ shape.quadric @ point), 0.0)))


def _ramp(images, spacing, found, middle, axis, length, z) -> list[np.ndarray]:
    """Return the profile along z of a ramp in every slice that shows its middle part."""
    slope = abs(axis[2]) / np.hypot(*axis[:2])  # mm along z per mm in the plane
    start, along = (turned(*vector[:2], found.roll_deg, found.mirrored) for vector in (middle, axis))
    along /= np.hypot(*axis[:2])
    half = length / 2 * np.hypot(*axis[:2])
    pixel = max(spacing[1:])
    u = np.arange(-half, half + 1e-9, pixel / 4)
    v = np.arange(-8, 8.01, 0.5) * pixel
    profiles = []
    for plane, (x, y) in zip(images, found.centers, strict=True):
        points = start + along * u[:, None] + 1j * along * v
        values = at(plane, spacing, x + points.real, y + points.imag)
        near = np.abs(v) <= 3 * pixel
        line = values[:, near].mean(axis=1) - np.median(values[:, ~near])
        line = ndimage.gaussian_filter1d(line, 1)
        top = u[np.argmax(line)]
        if line.max() < 5 * values[:, ~near].mean(axis=1).std() or abs(top) > half / 2:
            continue
        centroid = np.average(u, weights=np.where(line > line.max() / 2, line, 0))
        profiles.append(np.interp(z / slope + centroid, u, line, left=0, right=0))
    return profiles


def _bead(images, spacing, found, center, z) -> list[np.ndarray]:
    """Return the profile along z of a bead, if it is in the images."""
    position = turned(*center[:2], found.roll_deg, found.mirrored)
    sums, error = [], 0.0
    for plane, (x, y) in zip(images, found.centers, strict=True):
        _, _, distance = around(plane.shape, spacing, (x + position.real, y + position.imag))
        near, ring = distance < THIN_MM, (distance > THIN_MM) & (distance < 2 * THIN_MM)
        sums.append(plane[near].mean() - np.median(plane[ring]))
        error = max(error, plane[ring].std() / np.sqrt(near.sum()))
    if max(sums) < 5 * error:
        return []
    slices = np.arange(len(sums))
    middle = np.average(slices, weights=np.clip(sums, 0, None) ** 2)
    return [np.interp(z, (slices - middle) * spacing[0], sums, left=0, right=0)]
