"""Decide which features of a recording may be compared with features of a 3D simulation in HU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..features.names import FAMILIES, HISTOGRAM_ONLY, OTHER_FAMILIES, family, is_feature, unfiltered
from ..features.settings import SETTINGS

# First-order features that change if an offset is added to all voxels.
SHIFTED = tuple(
    f"original_firstorder_{name}"
    for name in "10Percentile 90Percentile Energy Maximum Mean Median Minimum RootMeanSquared TotalEnergy".split()
)


# Sums over voxels, runs or zones that are not divided by their number (Energy, non-uniformities), and powers of the
# size of zones. Zones of frequent gray levels span the ROI: with 26 neighbors, 10 % of random voxels percolate.
SIZED = (
    "original_firstorder_Energy",
    "original_firstorder_TotalEnergy",
    "original_gldm_DependenceNonUniformity",
    "original_gldm_GrayLevelNonUniformity",
    "original_glrlm_GrayLevelNonUniformity",
    "original_glrlm_RunLengthNonUniformity",
    "original_glszm_GrayLevelNonUniformity",
    "original_glszm_LargeAreaEmphasis",
    "original_glszm_LargeAreaHighGrayLevelEmphasis",
    "original_glszm_LargeAreaLowGrayLevelEmphasis",
    "original_glszm_SizeZoneNonUniformity",
    "original_glszm_ZoneVariance",
)


SHAPES = (OTHER_FAMILIES["shape"], OTHER_FAMILIES["shape2D"])
SAME_VOXELS = 1e-3  # relative difference of voxel number or volume; features give both up to rounding
# Columns with the number of voxels of an ROI: of this project, and of pyradiomics after and before resampling.
COUNTS = ("n_voxels", "diagnostics_Mask-interpolated_VoxelNum", "diagnostics_Mask-original_VoxelNum")


def comparable(
    features: Sequence[str],
    recording_dimensions: int,
    stored_offset: float,
    *,
    same_voxels: bool = False,
    other_settings: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """Decide which features of a recording may be compared with features of a 3D simulation in HU.

    Parameters
    ----------
    recording_dimensions : {2, 3}
        2 if the features were extracted from single slices.
    stored_offset : float
        Offset that was added to HU before extraction.
    same_voxels : bool, optional
        Both were extracted from ROIs of the same voxels on the same grid.
    other_settings : mapping of str to str, optional
        {feature: extraction settings that differ from the study's} (features.settings.other_settings).

    Returns
    -------
    DataFrame
        One row per feature: feature, family; flags by pyradiomics' definitions [1]_:

        * needs_hu: the value changes with the offset; features.hu_offset.convert_to_hu converts it
        * depends_on_bin_edges: bins of 25 HU start at multiples of 25, so other offsets move the edges by a fraction
          of a bin (1024: by one HU); concerns Entropy, Uniformity and all textures
        * depends_on_size: grows with the number of voxels of the ROI, or with its volume in mm^3 (TotalEnergy)
        * depends_on_voxel_size: counts neighbors or voxels, so it differs between grids
        * depends_on_dimensions: a pixel has 8 neighbors in a slice, a voxel 26 in a volume

        and comparable, with the reason:

        * "no": features with other settings, features that depend on size unless same_voxels, and dependence and zone
          features of slices, whose neighbor counts differ
        * "with care": co-occurrences and runs of slices, which are averaged over 4 directions instead of 13; expected
          values are equal only for isotropic textures and voxels
        * "yes": all others; depends_on_voxel_size alone is no reason, as voxel sizes are unknown here

    Raises
    ------
    InputError
        If dimensions are neither 2 nor 3, or a feature is unknown.

    References
    ----------
    .. [1] van Griethuysen et al., Cancer Res. 77, e104, 2017; https://pyradiomics.readthedocs.io, "Radiomic Features".
    """
    if recording_dimensions not in (2, 3):
        raise InputError(f"comparison: dimensions is {recording_dimensions}; use 2 or 3")
    if unknown := [feature for feature in features if not is_feature(feature)]:
        raise InputError(f"comparison: unknown feature {unknown[0]}; use the names of pyradiomics")
    rows = []
    for feature in features:
        alike = unfiltered(feature)
        shape = family(feature) in SHAPES
        texture = family(feature) != FAMILIES["firstorder"] and not shape
        binned = texture or feature.endswith(("_Entropy", "_Uniformity"))
        neighbours = texture and alike not in HISTOGRAM_ONLY
        row = {
            "feature": feature,
            "family": family(feature),
            "needs_hu": stored_offset != 0 and feature in SHIFTED,
            "depends_on_bin_edges": binned and stored_offset % SETTINGS["binWidth"] != 0,
            "depends_on_size": grows_with_roi(feature),
            "depends_on_voxel_size": neighbours or shape or (alike in SIZED and not feature.endswith("_TotalEnergy")),
            "depends_on_dimensions": neighbours and recording_dimensions == 2,
        }
        counted = family(feature) in (FAMILIES["gldm"], FAMILIES["glszm"])
        if other := (other_settings or {}).get(feature):
            verdict = "no", f"extracted with other settings: {other}"
        elif stored_offset != 0 and alike != feature:
            verdict = "no", "extracted from a filtered image with another HU offset"
        elif row["depends_on_size"] and not (same_voxels and recording_dimensions == 3):
            verdict = "no", "grows with the ROI"
        elif row["depends_on_dimensions"] and counted:
            verdict = "no", "neighbors are counted in a slice"
        elif row["depends_on_dimensions"]:
            verdict = "with care", "directions of a slice only"
        elif row["depends_on_bin_edges"]:
            verdict = "with care", "bin edges differ by a fraction of a bin"
        else:
            verdict = "yes", "after conversion to HU" if row["needs_hu"] else ""
        rows.append(row | dict(zip(("comparable", "reason"), verdict, strict=True)))
    return pd.DataFrame(rows)


def grows_with_roi(feature: str) -> bool:
    """Return whether a feature grows with the number of voxels or the volume of its ROI."""
    return unfiltered(feature) in SIZED or family(feature) in SHAPES


def other_sizes(
    simulated: pd.DataFrame, recorded: pd.DataFrame, features: Sequence[str], rois: Sequence[str]
) -> dict[str, str]:
    """Return the features that grow with the ROI, if its voxels differ between simulation and recording.

    Parameters
    ----------
    simulated, recorded : DataFrame
        One row per image and ROI. The number of voxels comes from Energy and RootMeanSquared (`roi_sizes`) or from a
        column of COUNTS; without either the result is empty.

    Returns
    -------
    dict of str to str
        {feature: description of the voxels of both}.
    """
    study_sizes, recorded_sizes = (_sizes(table, rois) for table in (simulated, recorded))
    if study_sizes is None or recorded_sizes is None:
        return {}
    count, volume = (study_sizes[name] / recorded_sizes[name] for name in ("n_voxels", "voxel_mm3"))
    # Without TotalEnergy the voxel volume is unknown and assumed to be equal.
    if (np.abs(pd.concat([count, volume]).dropna() - 1) < SAME_VOXELS).all():
        return {}
    words = f"{_sized(recorded_sizes)}, the study's {_sized(study_sizes)}"
    return {feature: words for feature in features if grows_with_roi(feature)}


def _sizes(table: pd.DataFrame, rois: Sequence[str]) -> pd.DataFrame | None:
    """Return `roi_sizes` indexed by ROI, or None if the table has neither features nor counts for it."""
    table = table[table["roi"].isin(rois)]
    if {"original_firstorder_Energy", "original_firstorder_RootMeanSquared"} <= set(table.columns):
        return roi_sizes(table).set_index("roi")
    column = next((name for name in COUNTS if name in table), None)
    if column is None:
        return None
    counts = pd.DataFrame({"roi": table["roi"], "n_voxels": pd.to_numeric(table[column], errors="coerce")})
    return counts.groupby("roi", sort=False).median().assign(voxel_mm3=np.nan)


def _sized(sizes: pd.DataFrame) -> str:
    low, high = (f"{count:.0f}" for count in (sizes["n_voxels"].min(), sizes["n_voxels"].max()))
    of = "" if sizes["voxel_mm3"].isna().all() else f" of {sizes['voxel_mm3'].median():.3g} mm³"
    return f"{low if low == high else f'{low} to {high}'} voxels{of}"


def roi_sizes(table: pd.DataFrame) -> pd.DataFrame:
    """Return number and volume of the voxels of each ROI, derived from first-order features.

    Energy is N RootMeanSquared^2, and TotalEnergy is Energy times the voxel's volume.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI.

    Returns
    -------
    DataFrame
        One row per ROI: roi, n_voxels (median over images), voxel_mm3 (missing without TotalEnergy).

    Raises
    ------
    InputError
        If Energy or RootMeanSquared is missing.
    """
    energy, square = "original_firstorder_Energy", "original_firstorder_RootMeanSquared"
    for name in (energy, square):
        if name not in table:
            raise InputError(f"features: {name} is missing; the size of the ROIs cannot be determined without it")
    total = table.get("original_firstorder_TotalEnergy", pd.Series(np.nan, table.index))
    sizes = pd.DataFrame(
        {"roi": table["roi"], "n_voxels": table[energy] / table[square] ** 2, "voxel_mm3": total / table[energy]}
    )
    return sizes.groupby("roi", sort=False).median().reset_index()
