"""Diagnosis of a recording whose object is not known: what its data show by themselves, and which fact would help most.

No effect is fitted. The checks need no model of the object: stored values, air, defective pixels, noise, repeated views
and the consistency conditions of consistency.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from ...base.geometry import PARALLEL, OrbitGeometry
from ...base.names import counted, enumerated
from ...base.vectors import FLAT
from ...recordings.projections import BITS_8, CLIPPED, Projections, ProjectionsRecording, quantized
from ...recordings.recording import Recording
from ...recordings.scan import ELEMENT, UNKNOWN
from ..fitting.nuisance import DEFAULTS
from ..projections.observed import MEDIAN_SQUARE, Scans, scans
from ..verdict.verdict import Diagnosis, unfitted_diagnosis
from ..verdict_text import VerdictLine
from .consistency import centroid_shift, opposite_rays, parallel_views, sums_of_views
from .data_checks import noise_by_transmission, smooth_transmission

OBJECT_UNKNOWN = "object not known"  # verdict
EDGE = 0.01  # share of the columns at either edge that may see air
EVEN, MOST_UNEVEN = 5.0, 0.05  # edges are air if at most this share is beyond these robust standard deviations
AIR_TOLERANCE = DEFAULTS["offset"][2]  # of line integrals in air
MOST_ROWS = 64  # rows that are tested for noise and defects
FEWEST_VIEWS = 30  # in which an object does not stand still, so that a defect is the pixel's
LEAST_GOOD = 0.5  # share of the views in which a tested pixel is usable
MOST_OF_RANGE = 0.1  # spread of air over the range of line integrals; more is not air
DEFECTIVE, LEAST_DEFECT = 10.0, 0.02  # robust standard deviations, and line integrals, between neighboring pixels
SIGNIFICANT = 4.0  # standard errors, or ratio to noise
SATURATES = 0.7  # ratio of the spreads of sums over parallel views, below which a saturation explains them
SAME_ANGLE_DEG = 0.02  # views are repeated if their angles differ by less
BLOCK = 16  # voxels along a side of blocks of images, whose standard deviation is measured
NO_AIR_HU = -900.0  # a smallest value above it is not air
NAMED_PIXELS = 4  # defective pixels in a text


@dataclass(frozen=True)
class DataFinding:
    """One finding: its subject, a sentence, and its numbers. `wrong` marks findings that the verdict names first."""

    subject: str
    text: str
    values: dict[str, float] = field(default_factory=dict)
    wrong: bool = False


@dataclass(frozen=True)
class DataMaps:
    """Maps for the report: line integrals (views, columns) or HU of a slice, and differences of rays or neighbors.

    Attributes
    ----------
    of : str
        What is subtracted from each other.
    quantity : {"line integrals", "HU"}
    """

    data: np.ndarray
    differences: np.ndarray
    of: str
    quantity: str

    @property
    def maps(self) -> tuple[np.ndarray, np.ndarray]:
        """Both maps."""
        return self.data, self.differences


def unknown_object_diagnosis(recording: Recording) -> Diagnosis:
    """Return the diagnosis of a recording of projections or images whose object is not known."""
    if isinstance(recording, ProjectionsRecording):
        findings, maps = _projection_findings(recording)
    else:
        findings, maps = list(_image_findings(recording)), _middle_slices(recording)
    facts = _helpful_facts(recording, findings)
    wrong = [finding.text for finding in findings if finding.wrong]
    rest = [finding.text for finding in findings if not finding.wrong]
    lines = [
        VerdictLine("Missing physics", f"not determined, because {enumerated(_unknown(recording, findings))}"),
        *([VerdictLine("Problems in the data", "; ".join(wrong))] if wrong else []),
        *([VerdictLine("Measured", "; ".join(rest))] if rest else []),
        VerdictLine("Next", "; then ".join(facts)),
    ]
    checks = [
        {"subject": finding.subject, "text": finding.text, "wrong": bool(finding.wrong), "values": finding.values}
        for finding in findings
    ]
    return unfitted_diagnosis(recording.name, OBJECT_UNKNOWN, lines, maps, data_checks=checks)


def _unknown(recording: Recording, findings: list[DataFinding]) -> list[str]:
    found = ["the scanned object is not known"]
    if any("clipped" in finding.text for finding in findings):
        found.append("values were clipped")
    if recording.kind == "projections":
        if recording.scan.get("angles_deg") == UNKNOWN:
            found.append("the view angles are not known")
        if recording.scan.get("length_unit") == ELEMENT:
            found.append("lengths are in detector elements")
        if "tube_kvp" not in recording.nominal and recording.scan.get("beam") != PARALLEL:
            found.append("the tube voltage is not stated")
    return found


def _helpful_facts(recording: Recording, findings: list[DataFinding]) -> list[str]:
    """Return what to state or to replace, the most helpful first."""
    facts = ["state the object and its material (diagnosis.recordings)"]
    subjects = [finding.subject for finding in findings if finding.wrong]
    if recording.kind != "projections":
        return ["give the images in HU as the scanner wrote them"] * ("stored values" in subjects) + facts
    scan = recording.scan
    if scan.get("angles_deg") == UNKNOWN:
        facts.insert(0, "state the view angles")
    if "stored values" in subjects:
        facts.insert(0, "give the counts as the detector read them, with a flat field")
    if scan.get("length_unit") == ELEMENT:
        facts.append("state the pixel size in mm")
    if scan.get("beam") == PARALLEL:
        facts += ["state the energy of the beam"] * ("energy_kev" not in recording.nominal)
    elif "tube_kvp" not in recording.nominal:
        facts.append("state tube voltage and filter")
    return facts


def _projection_findings(recording: ProjectionsRecording) -> tuple[list[DataFinding], DataMaps]:
    geometry, first = recording.geometry, recording.repeats[0]
    taken = scans(recording.repeats)
    mean = taken.repeats.mean(axis=0, dtype=np.float64)
    findings = [*_stored(recording, first), *_dark(first)]
    level, air = _air(mean)
    findings.append(air)
    row = mean.shape[1] // 2
    step = -(-mean.shape[1] // MOST_ROWS)
    rows = np.arange(row % step, mean.shape[1], step)
    defective = _defective(mean[:, rows], taken.usable[:, rows])
    findings += _defects(defective, rows)
    known_angles = recording.scan.get("angles_deg") != UNKNOWN
    clipped = any(finding.subject == "stored values" for finding in findings)
    noise = None if clipped else _noise(taken, level or 0.0)
    findings += [] if noise is None else [noise]
    middle, good = mean[:, row] - (level or 0.0), ~defective[row // step]
    middle = np.stack([np.interp(np.arange(good.size), np.flatnonzero(good), view[good]) for view in middle])
    differences, of = np.diff(middle, axis=1), "neighboring columns"
    if known_angles:
        findings += _repeated_views(taken, geometry)
        # The conditions of consistency hold for flat detectors and sources on a circle.
        plain = geometry.surface == FLAT and not (geometry.feed_per_rotation_mm or geometry.has_focal_spot_offset)
        if plain and level is not None and taken.usable[:, row].mean() > 0.9:
            found, opposite = _consistency(middle, geometry)
            findings += found
            if opposite is not None:
                differences, of = opposite, "opposite rays"
    return findings, DataMaps(middle, np.nan_to_num(differences), of, "line integrals")


def _stored(recording: ProjectionsRecording, first: Projections) -> Iterator[DataFinding]:
    for remark in dict.fromkeys([*filter(None, [recording.nominal.get("notes")]), *quantized(first.data)]):
        yield DataFinding("stored values", remark, wrong=True)


def _dark(acquisition: Projections) -> Iterator[DataFinding]:
    """Yield the share of dark signal in the counts, and the gain pattern of the white field."""
    if acquisition.log:
        return
    dark, counts = float(acquisition.dark.mean()), float(acquisition.data.mean())
    if dark > 0:
        share, signal = dark / counts, counts - dark
        yield DataFinding(
            "dark signal",
            f"dark signal is {dark:.4g} of {counts:.4g} counts ({100 * share:.2g} %): 1 % more would change line "
            f"integrals by {0.01 * dark / signal:.2g}",
            {"dark": dark, "share": share},
        )
    white = np.where(acquisition.dead, np.nan, acquisition.white - acquisition.dark)
    across = np.diff(np.log(white), axis=1) if white.shape[1] > 1 else np.zeros(1)
    pattern = float(np.sqrt(np.nanmedian(across**2) / MEDIAN_SQUARE / 2))
    if pattern > 0:
        yield DataFinding(
            "gain", f"the gain of neighboring pixels differs by {100 * pattern:.2g} % (SD)", {"sd": pattern}
        )


def _air(lines: np.ndarray) -> tuple[float | None, DataFinding]:
    """Return the line integral of air at the edges of the views, and the finding; None if the edges are not air."""
    count = max(2, round(EDGE * lines.shape[2]))
    edges = np.concatenate([lines[..., :count], lines[..., -count:]], axis=-1)
    level = float(np.median(edges))
    spread = float(np.sqrt(np.median((edges - level) ** 2) / MEDIAN_SQUARE))
    uneven = np.mean(np.abs(edges - level) > EVEN * spread + AIR_TOLERANCE) > MOST_UNEVEN
    if spread == 0:
        text = "all rays of air have the same value, so that exposure and noise cannot be checked"
        return level, DataFinding("air", text, {"level": level, "sd": 0.0}, wrong=True)
    if uneven or spread > MOST_OF_RANGE * (np.quantile(lines, 0.995) - level):
        text = "no column sees air in all views, so that the flat field and sums over columns cannot be checked"
        return None, DataFinding("air", text, wrong=True)
    wrong = abs(level) > SIGNIFICANT * AIR_TOLERANCE
    text = f"line integrals of air are {level:.3g} (SD {spread:.2g})" + (" instead of 0" if wrong else "")
    return level, DataFinding("air", text, {"level": level, "sd": spread}, wrong)


def _defective(lines: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return pixels that differ from both neighbors in the same direction in most views, shape (rows, columns).

    At the edge of a centered disc, which stays in one column, the values differ from one neighbor only, or lie between
    both.
    """
    found = np.zeros(lines.shape[1:], bool)
    if lines.shape[2] < 8 or len(lines) < FEWEST_VIEWS:
        return found
    steps = [lines[..., 1:-1] - lines[..., :-2], lines[..., 1:-1] - lines[..., 2:]]
    second = (steps[0] + steps[1]) / 2
    good = usable[..., 1:-1] & usable[..., :-2] & usable[..., 2:]
    typical = np.where(good.mean(axis=0) > LEAST_GOOD, np.median(np.where(good, second, 0.0), axis=0), 0.0)
    spread, size = float(np.sqrt(np.median(typical**2) / MEDIAN_SQUARE)), np.abs(typical)
    left, right = (np.median(np.where(good, step, 0.0), axis=0) for step in steps)
    least = max(DEFECTIVE * spread, LEAST_DEFECT)
    found[:, 1:-1] = (size > least) & (size == ndimage.maximum_filter(size, (1, 3)))
    found[:, 1:-1] &= (left * right > 0) & (np.minimum(np.abs(left), np.abs(right)) > least / 2)
    return found


def _defects(defective: np.ndarray, rows: np.ndarray) -> Iterator[DataFinding]:
    """Yield the defective pixels, shape (tested rows, columns)."""
    if defective.any():
        fan, pixels = len(defective) == 1, np.argwhere(defective)
        names = [f"{column}" if fan else f"row {rows[row]} column {column}" for row, column in pixels]
        listed = ", ".join(names[:NAMED_PIXELS]) + (", ..." if len(names) > NAMED_PIXELS else "")
        of = f" in {len(rows)} tested rows" if len(rows) > 1 else ""
        text = f"{counted(len(names), 'defective column' if fan else 'defective pixel')}{of} ({listed})"
        yield DataFinding("defective pixels", text, {"count": float(len(names))}, True)


def _noise(taken: Scans, air: float) -> DataFinding | None:
    """Return noise against signal: its variance is a + t / photons at the transmission t relative to air.

    Noise is measured by second differences along views and columns, in which a smooth object and fixed patterns cancel
    (D. L. Donoho and I. M. Johnstone, Biometrika 81, 425, 1994).
    """
    step = -(-taken.repeats.shape[2] // MOST_ROWS)
    lines, good = taken.repeats[0][:, ::step].astype(np.float64) - air, taken.usable[:, ::step]
    if lines.shape[0] < 3 or lines.shape[2] < 8:
        return None
    lines = np.where(good, lines, np.nan)
    second = lines[:-2] - 2 * lines[1:-1] + lines[2:]
    second = (second[..., :-2] - 2 * second[..., 1:-1] + second[..., 2:]) / 6  # variance 36 for independent noise
    transmission = smooth_transmission(lines, good)[1:-1, :, 1:-1]
    fitted = noise_by_transmission(second, transmission)
    if fitted is None:
        return None
    signal, variance, floor, slope = fitted
    of_air = float(np.sqrt(variance[-1]) / signal[-1])
    text = f"noise between neighbors is {of_air:.2g} of the signal of the least attenuated rays"
    values = {"relative_sd": of_air, "transmission": float(signal[-1])}
    if slope > 0 and np.ptp(signal) > 0.3:
        values |= {"photons_in_air": float(1 / slope), "floor_sd": float(np.sqrt(max(floor, 0.0)))}
        text += f", that of {1 / slope:.2g} photons per pixel in air"
    return DataFinding("noise", text, values)


def _repeated_views(taken: Scans, geometry: OrbitGeometry) -> Iterator[DataFinding]:
    """Yield the largest difference of views along the same direction, and the noise that neighboring columns show."""
    if geometry.feed_per_rotation_mm:
        return
    turned = np.degrees(geometry.angles_rad) % 360
    pairs = [
        (i, j)
        for i in range(len(turned))
        for j in np.flatnonzero(np.abs((turned[i + 1 :] - turned[i] + 180) % 360 - 180) < SAME_ANGLE_DEG) + i + 1
    ]
    found = []
    for i, j in pairs:
        both = taken.usable[i] & taken.usable[j]
        if both.sum() < 16:
            continue
        difference = np.where(both, taken.repeats[0][j] - taken.repeats[0][i], np.nan)
        across = np.diff(difference, axis=1) if difference.shape[1] > 1 else np.zeros(1)
        noise = float(np.sqrt(np.nanmedian(across**2) / MEDIAN_SQUARE / 2))
        rms, mean = float(np.sqrt(np.nanmean(difference**2))), float(np.nanmean(difference))
        found.append((rms, mean, noise, int(both.sum()), i, int(j)))
    if not found:
        return
    rms, mean, noise, rays, i, j = max(found)
    wrong = rms**2 > noise**2 * (1 + SIGNIFICANT * np.sqrt(2 / rays)) + AIR_TOLERANCE**2
    text = f"views {i} and {j}, along the same direction, differ by {rms:.2g} RMS (mean {mean:.2g}; noise {noise:.2g})"
    if wrong:
        text += ": exposure, object or geometry changed within the scan"
    yield DataFinding("repeated views", text, {"rms": rms, "mean": mean, "noise": noise}, wrong)


def _consistency(lines: np.ndarray, geometry: OrbitGeometry) -> tuple[list[DataFinding], np.ndarray | None]:
    """Return findings of the consistency conditions in the plane of the source, and the map of opposite rays."""
    findings, opposite, shift = [], opposite_rays(lines, geometry), None
    views = parallel_views(lines, geometry, opposite.shift_px if opposite else 0.0)
    if opposite is not None:
        shift = opposite.shift_px, opposite.shift_error
        if opposite.rms_reversed < opposite.rms:
            text = "opposite rays agree better with the direction of rotation reversed; correct scan.direction"
            findings.append(DataFinding("geometry", text, wrong=True))
        else:
            findings.append(
                DataFinding(
                    "geometry",
                    f"opposite rays differ by {opposite.rms:.2g} RMS, at {opposite.distance:.3f} ± "
                    f"{opposite.distance_error:.3f} of the stated distance to the detector",
                    {"rms": opposite.rms, "distance": opposite.distance, "distance_error": opposite.distance_error},
                )
            )
    elif geometry.parallel and views is not None:
        shift = centroid_shift(views, geometry)
    if shift is not None:
        wrong = abs(shift[0]) > max(SIGNIFICANT * shift[1], 0.05)
        text = f"the center of rotation is {shift[0]:.2g} ± {shift[1]:.1g} columns off the stated one"
        findings.append(
            DataFinding("center of rotation", text, dict(zip(("shift_px", "error"), shift, strict=True)), wrong)
        )
    if views is not None and len(views) > 3:
        findings += _linearity(views)
    return findings, None if opposite is None else opposite.residual


def _linearity(views: np.ndarray) -> Iterator[DataFinding]:
    sums = sums_of_views(views)
    if sums.spread < SIGNIFICANT * sums.noise:
        text = f"sums over parallel views vary by {100 * sums.spread:.2g} %, as noise does"
        yield DataFinding("linearity", text, {"spread": sums.spread})
        return
    text = f"sums over parallel views vary by {100 * sums.spread:.2g} % (SD)"
    values = {"spread": sums.spread, "noise": sums.noise}
    if sums.spread_corrected < SATURATES * sums.spread:
        values |= {"saturation": sums.saturation, "spread_corrected": sums.spread_corrected}
        text += (
            f"; {100 * sums.spread_corrected:.2g} % remain if a saturation at {sums.saturation:.3g} is corrected (beam "
            "hardening, scatter or both, which these data do not distinguish)"
        )
    else:
        text += ", which no saturation explains: exposure, object or geometry changed within the scan"
    yield DataFinding("linearity", text, values, True)


def _image_findings(recording: Recording) -> Iterator[DataFinding]:
    """Yield few levels and clipping, and the noise: the SD in the most uniform blocks of each repeat's slices."""
    found, values, clipped = [], recording.repeats[0].array, []
    levels, counts = np.unique(values, return_counts=True)
    if levels.size <= BITS_8:
        step = float(np.median(np.diff(levels))) if levels.size > 1 else 0.0
        text = f"values have {levels.size} levels: steps of {step:.3g} HU hide noise and small differences"
        yield DataFinding("stored values", text, {"levels": float(levels.size), "step": step}, wrong=True)
    ends = [("largest", -1, -2)] + ([("smallest", 0, 1)] if levels[0] > NO_AIR_HU else [])
    for which, end, next_to_it in ends if levels.size > 1 else ():
        if counts[end] > max(CLIPPED * values.size, 2 * counts[next_to_it]):
            clipped.append(levels[end])
            share = 100 * counts[end] / values.size
            text = f"{share:.2g} % of the values are {levels[end]:.5g} HU, the {which} one: they were clipped"
            yield DataFinding("stored values", text, {which: float(levels[end]), "share": share / 100}, wrong=True)
    for image in recording.repeats:
        blocks = [
            slice_hu[y : y + BLOCK, x : x + BLOCK]
            for slice_hu in image.array
            for y in range(0, slice_hu.shape[0] - BLOCK + 1, BLOCK)
            for x in range(0, slice_hu.shape[1] - BLOCK + 1, BLOCK)
        ]
        uniform = [block.std() for block in blocks if -200 < block.mean() < 200 and not np.isin(clipped, block).any()]
        if uniform:
            found.append(float(np.quantile(uniform, 0.05)))
    if found:
        of_repeats = enumerated([f"{sd:.3g}" for sd in found])
        text = f"noise in the most uniform blocks of {BLOCK} x {BLOCK} voxels is {of_repeats} HU"
        yield DataFinding("noise", text, {f"repeat_{index}": sd for index, sd in enumerate(found)})


def _middle_slices(recording: Recording) -> DataMaps:
    image = recording.repeats[0].array
    middle = image[len(image) // 2]
    return DataMaps(middle, np.diff(middle, axis=1), "neighboring columns", "HU")
