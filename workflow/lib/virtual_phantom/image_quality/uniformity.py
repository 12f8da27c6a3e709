"""Uniformity of a module without inserts: cupping, rings and crescents.

Cupping is fitted by the form of beam hardening in a disc of radius R, with line integrals p = 2 mu sqrt(R^2 - s^2).
A term p^2 gives an image proportional to sqrt(R^2 - r^2). A term p^3 gives R^2 - r^2. Over-corrected hardening has a
bright center.

Rings are what a high-pass filter leaves of the radial profile of each slice about the center of the image, which is
taken for the isocenter. The same about displaced centers shows the part of noise.

Crescents arise in scans of half a turn from errors that are fixed in the detector [1]_. Let q(s) be the error of the
filtered line integral at the distance s from the isocenter. The image is then

    integral of q(r cos(phi - theta)) over theta, from the start angle t to t + pi.

The even part of q makes rings about the isocenter. The odd part makes arcs of half a turn at r = s, of opposite sign on
opposite sides. Over a full turn it cancels. A short scan weighs opposite views smoothly, which makes the ends of the
half turn gradual.

References
----------
.. [1] W. Giles et al., Crescent artifacts in cone-beam CT, Med. Phys. 38, 2116, 2011: scans of 200 degrees, in which
   the bowtie filter or the tube was displaced relative to the blank scan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import ndimage
from scipy.optimize import minimize

from ..recordings.in_plane import around, at
from .location import NOISE_MARGIN_MM, Layout, Location

REGION_MM, REGION_AT = 10.0, 0.7  # radius of the five regions, and their distance in radii of the medium
MARGIN_MM = 4.0  # at the border of the object
ANGLES = 90  # of polar maps; even
TAPERS_DEG = (0.0, 20.0, 40.0, 60.0)  # widths of the ends of the half turn
RING_MM = 4.0  # standard deviation of the Gaussian that is subtracted from profiles to find rings
RING_AWAY_MM = 15.0  # displacement of the centers that show the part of noise
VIEWS = 720  # of the integral over theta
EXPLAINED, EXPLAINED_CRESCENT = 0.9, 0.8  # smallest shares of variance that a form explains
LEAST_RINGS = 0.3  # smallest excess of ring variance, relative to noise
LEAST_CRESCENT_HU = 3.0  # smallest RMS over the angle
LEAST_RADIUS_MM = 5.0  # of a crescent; noise dominates below
FARTHEST_MM = 10.0  # of the fitted center from the center of the image
SMOOTHED_MM = 1.0  # SD of the filter before crescents are fitted
RIDGE = 1e-6  # of the least squares, relative to the mean square of the basis


@dataclass(frozen=True)
class HalfTurn:
    """Fit of an error of detector columns in a scan of half a turn.

    Attributes
    ----------
    share : float
        Fitted share of the angular variance of the image.
    start_deg : float
        Angle t from +x to +y of the image, degrees; 0 to 180, because the sign of q is fitted.
    image : ndarray, shape (radii, ANGLES)
        Fitted polar map.
    """

    share: float
    start_deg: float
    image: np.ndarray


def uniformity(
    images: np.ndarray, spacing: Sequence[float], known: Layout, found: Location
) -> tuple[dict, pd.DataFrame, pd.DataFrame]:
    """Measure the uniformity of the mean of all slices.

    Returns
    -------
    content : dict
        As in schemas/image_quality.schema.yaml.
    radial : DataFrame
        Columns r_mm, hu, error_hu (of the mean over angles and slices), cupping_hu (fit; NaN outside the medium).
    angular : DataFrame
        Columns r_mm, angle_deg, hu (relative to the mean of the radius), half_turn_hu (fit, if there is a crescent).
    """
    mean = images.mean(axis=0)
    center = found.centers.mean(axis=0)
    content: dict = {"regions": _regions(images, spacing, known, found)}
    radial, cupping = _radial(images, spacing, known, found)
    angular, crescent = _angular(mean, spacing, known, center, radial)
    content |= cupping | crescent
    return content | {"explanations": explain(content)}, radial, angular


def _regions(images, spacing, known: Layout, found: Location) -> dict[str, float]:
    """Return mean HU of five discs: center, and four that lie in directions of the image's axes."""
    away = REGION_AT * known.medium_radius
    places = {"center": (0, 0), "top": (0, away), "bottom": (0, -away), "left": (away, 0), "right": (-away, 0)}
    result = {}
    for name, (dx, dy) in places.items():
        values = [
            plane[around(plane.shape, spacing, (x + dx, y + dy))[2] < REGION_MM].mean()
            for plane, (x, y) in zip(images, found.centers, strict=True)
        ]
        result[name] = float(np.mean(values))
    return result


def _radial(images, spacing, known: Layout, found: Location) -> tuple[pd.DataFrame, dict]:
    step = max(spacing[1:])
    reach = known.body_radius - MARGIN_MM
    profiles, pixels = _profiles(images, spacing, found.centers, reach)
    r = (np.arange(len(pixels)) + 0.5) * step
    hu = profiles.mean(axis=0)
    error = profiles.std(axis=0, ddof=1) / np.sqrt(len(profiles)) if len(profiles) > 1 else np.full(len(r), np.nan)
    inside = r < known.medium_radius - NOISE_MARGIN_MM
    depth = 1 - (r / known.body_radius) ** 2
    basis, weight = np.column_stack([np.ones(len(r)), np.sqrt(depth), depth]), np.sqrt(pixels)
    fit = np.linalg.lstsq((basis * weight[:, None])[inside], (hu * weight)[inside], rcond=None)[0]
    cupping = np.where(r < known.medium_radius, basis @ fit, np.nan)

    def square(values):
        return float(np.average(values[inside] ** 2, weights=pixels[inside]))

    mean = np.average(hu[inside], weights=pixels[inside])
    table = pd.DataFrame({"r_mm": r, "hu": hu, "error_hu": error, "cupping_hu": cupping})
    return table, {
        "cupping_hu": float(cupping[inside][-1] - cupping[inside][0]),
        "cupping_to_mm": float(r[inside][-1]),
        "cupping_share": 1 - square(hu - cupping) / square(hu - mean),
        "rings": _rings(images, spacing, known, found),
    }


def _profiles(images, spacing, centers, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the radial profile of each slice about its center, and the pixels of each radius."""
    step = max(spacing[1:])
    count, profiles = int(reach / step), []
    for plane, center in zip(images, centers, strict=True):
        index = (around(plane.shape, spacing, center)[2] / step).astype(int)
        kept = index < count
        pixels = np.bincount(index[kept], minlength=count)
        profiles.append(np.bincount(index[kept], plane[kept], count) / pixels)
    return np.array(profiles), pixels


def _rings(images, spacing, known: Layout, found: Location) -> dict[str, float]:
    """Return variances of filtered radial profiles, HU^2: about the image's center, the object, and displaced centers.

    `shared` is the mean product of different slices, the part that slices have in common.
    """
    reach = known.medium_radius - NOISE_MARGIN_MM - RING_AWAY_MM

    def variances(centers) -> tuple[float, float]:
        profiles, pixels = _profiles(images, spacing, np.broadcast_to(centers, (len(images), 2)), reach)
        high = profiles - ndimage.gaussian_filter1d(profiles, RING_MM / max(spacing[1:]), axis=1)
        each = float(np.average((high**2).mean(axis=0), weights=pixels))
        all_slices, n = float(np.average(high.sum(axis=0) ** 2, weights=pixels)), len(images)
        return each, (all_slices - n * each) / (n * (n - 1)) if n > 1 else each

    away = RING_AWAY_MM * np.exp(2j * np.pi * np.arange(6) / 6)
    center, shared = variances((0.0, 0.0))
    return {
        "image_center": center,
        "object_center": variances(found.centers)[0],
        "displaced": float(np.mean([variances((one.real, one.imag))[0] for one in away])),
        "shared": shared,
    }


def _angular(mean, spacing, known: Layout, center, radial: pd.DataFrame) -> tuple[pd.DataFrame, dict]:
    """Remove the radial profile, and fit the rest by a half turn; its center is fitted too."""
    _, _, distance = around(mean.shape, spacing, center)
    rest = mean - np.interp(distance, radial["r_mm"], radial["hu"])
    rest = ndimage.gaussian_filter(rest, SMOOTHED_MM / max(spacing[1:]))
    r = np.arange(0.5, known.body_radius - MARGIN_MM, 1.0)
    phi = np.arange(ANGLES) * 2 * np.pi / ANGLES

    def polar(x: float, y: float) -> np.ndarray:
        values = at(rest, spacing, x + np.outer(r, np.cos(phi)), y + np.outer(r, np.sin(phi)))
        return values - values.mean(axis=1, keepdims=True)

    values = polar(0.0, 0.0)
    rms = np.sqrt((values**2).mean(axis=1)) * (r > LEAST_RADIUS_MM)
    strongest = int(np.argmax(rms))
    content = {
        "crescent_rms_hu": float(rms[strongest]),
        "crescent_r_mm": float(r[strongest]),
        "crescent_angle_deg": float(np.degrees(-np.angle(np.fft.rfft(values[strongest])[1])) % 360),
        "object_center_mm": [float(v) for v in center],
        "half_turn": None,
    }
    table = {"r_mm": np.repeat(r, ANGLES), "angle_deg": np.tile(np.degrees(phi), len(r)), "hu": values.ravel()}
    if rms[strongest] < LEAST_CRESCENT_HU:
        return pd.DataFrame(table), content
    fits = (_HalfTurnFit(r, taper) for taper in TAPERS_DEG)
    kernel = max(fits, key=lambda kernel: kernel.fit(values).share)
    search = {"initial_simplex": [[0, 0], [1, 0], [0, 1]], "xatol": 0.02, "fatol": 1e-5, "maxfev": 50}
    moved = minimize(
        lambda place: -kernel.fit(polar(*place)).share,
        [0, 0],
        method="Nelder-Mead",
        bounds=[(-FARTHEST_MM, FARTHEST_MM)] * 2,
        options=search,
    )
    values = polar(*moved.x)
    fit = kernel.fit(values)
    odd = (values - np.roll(values, ANGLES // 2, axis=1)) / 2
    content["half_turn"] = {
        "share": fit.share,
        "odd_share": float((r[:, None] * odd**2).sum() / (r[:, None] * values**2).sum()),
        "start_deg": fit.start_deg,
        "center_mm": [float(v) for v in moved.x],
    }
    return pd.DataFrame(table | {"hu": values.ravel(), "half_turn_hu": fit.image.ravel()}), content


def explain(found: Mapping) -> list[str]:
    """Return sentences on cupping, rings and crescent, with the evidence, from the content of `uniformity`."""
    change, share = found["cupping_hu"], found["cupping_share"]
    kind = "over-corrected" if change < 0 else "uncorrected"
    cause = f"The form is that of {kind} beam hardening or scatter, which one object cannot distinguish"
    side = "lower" if change < 0 else "higher"
    sentences = [
        f"Cupping: {abs(change):.0f} HU {side} at {found['cupping_to_mm']:.0f} mm than in the center. "
        f"{cause if share >= EXPLAINED else 'Unexplained: not the form of beam hardening'} "
        f"({100 * share:.0f} % of the radial variance)."
    ]
    rings = found["rings"]
    excess = rings["image_center"] - rings["displaced"]
    if excess <= LEAST_RINGS * rings["displaced"]:
        sentences.append("Rings: none beyond noise.")
    else:
        fixed, shared = rings["image_center"] > rings["object_center"], max(rings["shared"], 0) / excess
        sentences.append(
            f"Rings: SD of {np.sqrt(excess):.1f} HU beyond noise; slices share {100 * shared:.0f} % of the variance. "
            f"They are {'weaker' if fixed else 'not weaker'} about the object's center than about the image's: "
            f"{'errors of detector elements' if fixed else 'unexplained'}."
        )
    rms, fit = found["crescent_rms_hu"], found["half_turn"]
    if fit is None:
        return [*sentences, f"Crescent: none above {LEAST_CRESCENT_HU:g} HU (RMS over the angle)."]
    share, odd, center = fit["share"], fit["odd_share"], complex(*fit["center_mm"])
    away = abs(center), abs(center - complex(*found["object_center_mm"]))
    explained = share >= EXPLAINED_CRESCENT and odd >= EXPLAINED and away[0] < away[1]
    sentences += [
        f"Crescent: RMS of {rms:.0f} HU at a radius of {found['crescent_r_mm']:.0f} mm, brightest at "
        f"{found['crescent_angle_deg']:.0f} degrees. Opposite sides have opposite signs ({100 * odd:.0f} % of the "
        f"angular variance). An error of detector columns in a scan of half a turn fits {100 * share:.0f} %. The "
        f"fitted center is {away[0]:.1f} mm from the image's center and {away[1]:.1f} mm from the object's.",
        "Such errors arise if bowtie filter or tube are displaced relative to the blank scan (Giles et al., Med. Phys. "
        "38, 2116, 2011). Scan the rotated phantom to confirm that the crescent does not rotate."
        if explained
        else "The crescent is unexplained.",
    ]
    return sentences


class _HalfTurnFit:
    """Least squares of polar maps by the odd part of q, for all start angles that are multiples of 360 / ANGLES."""

    def __init__(self, r: np.ndarray, taper_deg: float):
        self.r = r
        columns = int(np.ceil(r[-1]))
        theta = (np.arange(VIEWS) + 0.5) * 2 * np.pi / VIEWS
        turn = (theta + np.pi / 2) % (2 * np.pi) - np.pi / 2  # -90 to 270 degrees; the half turn is 0 to 180
        if taper_deg:
            ends = np.clip(np.minimum(turn, np.pi - turn) / np.radians(taper_deg) + 0.5, 0, 1)
        else:
            ends = (turn >= 0) & (turn < np.pi)
        self.basis = np.empty((len(r), ANGLES, columns))
        for j in range(ANGLES):
            position = np.outer(r, np.cos(2 * np.pi * j / ANGLES - theta))
            low = np.floor(np.abs(position)).astype(int)
            share, sign = np.abs(position) - low, np.sign(position) * ends * 2 / VIEWS
            row = np.arange(len(r))[:, None] * (columns + 2)
            size = len(r) * (columns + 2)
            sums = np.bincount((row + low).ravel(), (sign * (1 - share)).ravel(), size)
            sums += np.bincount((row + low + 1).ravel(), (sign * share).ravel(), size)
            self.basis[:, j] = sums.reshape(len(r), columns + 2)[:, 1:-1]
        self.basis -= self.basis.mean(axis=1, keepdims=True)
        weighted = (np.sqrt(r)[:, None, None] * self.basis).reshape(-1, columns)
        self.square = weighted.T @ weighted
        self.inverse = np.linalg.inv(self.square + RIDGE * np.trace(self.square) / columns * np.eye(columns))
        self.weighted = weighted

    def fit(self, values: np.ndarray) -> HalfTurn:
        """Return the best fit of a polar map, shape (radii, ANGLES)."""
        weighted = np.sqrt(self.r)[:, None] * values
        turned = np.stack([np.roll(weighted, -k, axis=1).ravel() for k in range(ANGLES)], axis=1)
        right = self.weighted.T @ turned
        solved = self.inverse @ right
        explained = 2 * (right * solved).sum(axis=0) - ((self.square @ solved) * solved).sum(axis=0)
        k = int(np.argmax(explained))
        image = np.roll((self.basis @ solved[:, k]), k, axis=1)
        share = float(explained[k] / (weighted**2).sum())
        return HalfTurn(share, 360 / ANGLES * k % 180, image)
