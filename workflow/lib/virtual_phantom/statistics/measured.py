"""Measured features of the printed phantom: summaries that come with the package, and the full published tables.

Two public data sets of the anthropomorphic phantom that Flouris et al. simulate (see README.md of the resources):

* CT-Phantom4Radiomics, TCIA, doi 10.7937/a1v1-rc66, CC BY 4.0: 8 parameter groups on one scanner. The features
  (public repository Joingl/radiomic-features) are from the largest 2D cross-section of each ROI, with pixel
  spacing 1 and bin width 25, on stored values (HU + 1024).
* CT4Harmonization-Multicentric, TCIA, CC BY 4.0: one Siemens SOMATOM Definition Edge, 1, 3 and 10 mGy, two
  reconstructions. The features (public repository mariamartinasiain/radiomics_phantom_dose_analysis, MIT) are 3D,
  in HU.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..features import consistency
from ..features.names import FEATURES
from ..features.table_files import read_table
from ..io.files import read_csv

FIRST_REPOSITIONED = 21  # of 30 acquisitions; Flouris et al., Sci. Rep. 12, 4732 (2022), methods
ACQUISITIONS = ("fixed", "all")  # without and with re-positioned acquisitions
TISSUE_CLASSES = {
    "normal_1": "normal_liver",
    "normal_2": "normal_liver",
    "cyst_1": "cyst",
    "cyst_2": "cyst",
    "hemangioma": "hemangioma",
    "metastasis": "metastasis",
}
# {ROI in the data set: ROI of the printed phantom here}. The dose series names ROIs by size. They were matched to the
# ROIs of the paper by mean HU.
PHANTOM4RADIOMICS_ROIS = {
    "n1": "normal_1",
    "n2": "normal_2",
    "c1": "cyst_1",
    "c2": "cyst_2",
    "hem": "hemangioma",
    "met": "metastasis",
}
DOSE_ROIS = {
    "normal_large": "normal_1",
    "normal_small": "normal_2",
    "cyst_large": "cyst_1",
    "cyst_small": "cyst_2",
    "hemangioma": "hemangioma",
    "metastasis": "metastasis",
}
# The data set does not name its reconstructions; the noisier one is taken as FBP.
DOSE_RECONSTRUCTIONS = {1: "fbp", 2: "iterative"}
# pyradiomics gives no TotalEnergy for 2D regions.
PHANTOM4RADIOMICS_FEATURES = tuple(feature for feature in FEATURES if not feature.endswith("_TotalEnergy"))


def load_group_summary() -> pd.DataFrame:
    """Mean and SD (n - 1) over scans of each feature in CT-Phantom4Radiomics, first-order features in HU.

    Returns
    -------
    DataFrame
        Columns group (1 to 8), roi, tissue_class, feature (85 of the 86), mean, sd, n.
    """
    table = read_csv(RESOURCES / "ct_phantom4radiomics_groups.csv")
    table.insert(table.columns.get_loc("roi") + 1, "tissue_class", table["roi"].map(TISSUE_CLASSES))
    return table


def group_means() -> pd.DataFrame:
    """Means of `load_group_summary`: one row per group and ROI, one column per feature."""
    wide = load_group_summary().pivot(index=["group", "roi", "tissue_class"], columns="feature", values="mean")
    return wide.reset_index().rename_axis(columns=None)


def load_score_draws(repeats: int, acquisitions: str = "fixed") -> pd.DataFrame:
    """Scores measured in CT-Phantom4Radiomics, in random subsamples with as many acquisitions as a study has repeats.

    They are from `statistics.wilcoxon.scores` at threshold 1, per ROI, over 8 groups, with features of stored values
    (HU + 1024).

    Parameters
    ----------
    repeats : int
        Acquisitions of each group, at least 2. Values above the largest number with draws are replaced by it.
    acquisitions : {"fixed", "all"}, optional
        "fixed": from the 19 that all groups have without re-positioning; "all": from all 29.

    Returns
    -------
    DataFrame
        One row per draw and feature, as in `statistics.repeats.score_draws`.

    Raises
    ------
    InputError
        For unknown `acquisitions`, or a number of repeats without draws.
    """
    draws = read_csv(RESOURCES / "ct_phantom4radiomics_draws.csv")
    draws = draws[draws["acquisitions"] == acquisitions]
    if draws.empty:
        raise InputError(f"measured scores: {acquisitions!r} is not known; choose from {', '.join(ACQUISITIONS)}")
    draws = draws[draws["repeats"] == min(repeats, draws["repeats"].max())]
    if draws.empty:
        raise InputError(
            f"measured scores: there are no draws of {repeats} acquisitions from {acquisitions!r}; use at least 2"
        )
    keys = ["repeats", "of", "draw"]
    counts = draws.melt(
        id_vars=[*keys, "kind", "comparisons"], value_vars=list(PHANTOM4RADIOMICS_FEATURES), var_name="feature"
    )
    counts["percent"] = 100 * counts["value"] / counts["comparisons"]
    wide = counts.pivot(index=[*keys, "feature"], columns="kind", values="percent").reset_index()
    order = wide["feature"].map(PHANTOM4RADIOMICS_FEATURES.index)
    wide = wide.assign(_order=order).sort_values(["draw", "_order"], ignore_index=True).drop(columns="_order")
    return wide.rename(columns=lambda name: f"{name}_percent" if name in ("stability", "discrimination") else name)


def load_full_table(path: str | Path) -> pd.DataFrame:
    """Read the published CSV of CT-Phantom4Radiomics features; values are as stored (HU + 1024).

    Returns
    -------
    DataFrame
        Columns scan, group, acquisition (1 to 30, see `true_acquisition`), repositioned (0 or 1), roi, tissue_class,
        n_voxels, 85 features.

    Raises
    ------
    InputError
        If the file is missing, lacks a column, or has an unknown ROI or group, or values that are not finite.
    """
    raw = _source_table(
        path, ["scan_id", "group", "class", "mask size"], PHANTOM4RADIOMICS_FEATURES, {"class": PHANTOM4RADIOMICS_ROIS}
    )
    scan = raw["scan_id"].astype(str).str.extract(r"^(\d{3})-", expand=False)
    if scan.isna().any() or (scan.str[0].astype(int) != raw["group"]).any():
        raise InputError(f"{path}: a scan_id does not begin with the digit of its group; use the published table")
    roi = raw["class"].map(PHANTOM4RADIOMICS_ROIS)
    acquisition = true_acquisition(raw["group"].to_numpy(), scan.str[1:].astype(int).to_numpy())
    keys = pd.DataFrame(
        {
            "scan": scan.astype(int),
            "group": raw["group"],
            "acquisition": acquisition,
            "repositioned": (acquisition >= FIRST_REPOSITIONED).astype(int),
            "roi": roi,
            "tissue_class": roi.map(TISSUE_CLASSES),
            "n_voxels": raw["mask size"],
        }
    )
    return pd.concat([keys, raw[list(PHANTOM4RADIOMICS_FEATURES)]], axis="columns")


def true_acquisition(group: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Acquisition (1 to 30) that a scan of CT-Phantom4Radiomics reconstructs.

    All groups reconstruct the same acquisitions, but number them differently:

    * groups 1 and 2 start with acquisition 2,
    * in group 3, numbers 11 to 15 are acquisitions 21 to 25, and numbers 16 to 25 are acquisitions 20 to 11.

    This was found from the ROI means, which agree between groups, and checked with the positions of the masks,
    which change with each re-positioning (tests/test_measured.py).

    Parameters
    ----------
    group : array_like of int
        1 to 8.
    number : array_like of int
        Digits 2 and 3 of the scan's name.
    """
    group, number = np.asarray(group), np.asarray(number)
    third = np.select(
        [(number >= 11) & (number <= 15), (number >= 16) & (number <= 25)], [number + 10, 36 - number], number
    )
    return np.select([group <= 2, group == 3], [number + 1, third], number)


def load_full_dose_series(path: str | Path) -> pd.DataFrame:
    """Read the published CSV of the dose series of CT4Harmonization-Multicentric; values are in HU.

    Returns
    -------
    DataFrame
        Columns dose_mgy, reconstruction (fbp | iterative), repeat (1, 2, ...), roi, tissue_class, 86 features.

    Raises
    ------
    InputError
        If the file is missing, lacks a column, or has an unknown ROI or reconstruction, or values that are not finite.
    """
    known = {"roi6": DOSE_ROIS, "recon_code": DOSE_RECONSTRUCTIONS}
    raw = _source_table(path, ["dose_mGy", "recon_code", "repeat", "roi6"], FEATURES, known)
    roi = raw["roi6"].map(DOSE_ROIS)
    keys = pd.DataFrame(
        {
            "dose_mgy": raw["dose_mGy"],
            "reconstruction": raw["recon_code"].map(DOSE_RECONSTRUCTIONS),
            "repeat": raw["repeat"],
            "roi": roi,
            "tissue_class": roi.map(TISSUE_CLASSES),
        }
    )
    return pd.concat([keys, raw[list(FEATURES)]], axis="columns")


def _source_table(path, columns, features, known) -> pd.DataFrame:
    """Read a published table; InputError for missing columns, values that are not `known`, or non-finite features."""
    raw = read_table(path, advice="use the published table")
    if missing := [column for column in (*columns, *features) if column not in raw]:
        raise InputError(
            f"{path}: lacks {len(missing)} column(s) of the published table, the first {missing[0]!r}; use the "
            "published table"
        )
    for column, values in known.items():
        if unknown := sorted(map(str, set(raw[column]) - set(values))):
            raise InputError(f"{path}: {column} {unknown[0]!r} is unknown; known are {', '.join(map(str, values))}")
    if not np.isfinite(raw[list(features)].to_numpy(dtype=np.float64)).all():
        raise InputError(f"{path}: has features that are not finite; use the published table")
    consistency.check(raw, str(path))
    return raw.reset_index(drop=True)


def load_published_top() -> pd.DataFrame:
    """Ten highest-ranked features in the appendix of Flouris et al., Sci. Rep. 12, 2022, with pyradiomics names.

    Columns: kind (stability | discrimination), source (simulator | phantom), rank, feature.
    """
    return read_csv(RESOURCES / "published_top_features.csv")
