"""Measured references: facts derived from scans of the real phantom, and the full table where a user has it.

Two public data sets of the anthropomorphic phantom that the paper simulates (see README.md of the resources):

* CT-Phantom4Radiomics, TCIA, doi 10.7937/a1v1-rc66, CC BY 4.0: the paper's tandem study, 8 parameter groups,
  one scanner. Features (public repository Joingl/radiomic-features) are of the largest 2D cross-section of each ROI,
  pixel spacing 1, on stored values (HU + 1024), bin width 25.
* CT4Harmonization-Multicentric, TCIA, CC BY 4.0: here one Siemens SOMATOM Definition Edge, 1, 3 and 10 mGy,
  two reconstructions. Features (public repository mariamartinasiain/radiomics_phantom_dose_analysis, MIT)
  are 3D, in HU.
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
from . import dose_series

FIRST_REPOSITIONED = 21  # of 30 acquisitions; Flouris et al., Sci. Rep. 12, 4732 (2022), methods
ACQUISITIONS = ("fixed", "all")  # without re-positioning, or with
TISSUE_CLASSES = {
    "normal_1": "normal_liver",
    "normal_2": "normal_liver",
    "cyst_1": "cyst",
    "cyst_2": "cyst",
    "hemangioma": "hemangioma",
    "metastasis": "metastasis",
}
# The paper's names of the ROIs. The dose series names them by size; they are matched by mean HU.
STUDY_ROIS = {
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
# Which of the two reconstructions is which is inferred from their noise: the noisier one is taken as FBP.
DOSE_RECONSTRUCTIONS = {1: "fbp", 2: "iterative"}
# 2D regions have no TotalEnergy.
STUDY_FEATURES = tuple(feature for feature in FEATURES if not feature.endswith("_TotalEnergy"))


def load_group_summary() -> pd.DataFrame:
    """Mean and SD (n - 1) over scans of each feature in CT-Phantom4Radiomics, first-order features in HU.

    Returns
    -------
    DataFrame
        Columns group (1 to 8), roi, tissue_class, feature (85 of the 86), mean, sd, n.
    """
    return _with_classes(read_csv(RESOURCES / "ct_phantom4radiomics_groups.csv"))


def group_means() -> pd.DataFrame:
    """The means of `load_group_summary`, one row per group and ROI, one column per feature."""
    wide = load_group_summary().pivot(index=["group", "roi", "tissue_class"], columns="feature", values="mean")
    return wide.reset_index().rename_axis(columns=None)


def load_scores() -> pd.DataFrame:
    """Stability and discriminative power measured in CT-Phantom4Radiomics.

    From stored values as published and from all 29 or 30 acquisitions, re-positioned ones among them. Not to be set
    beside scores of fewer repeats: |W| grows with their root. See `load_score_draws`.

    Returns
    -------
    DataFrame
        Columns feature (85 of the 86), stability_percent, discrimination_percent; `statistics.wilcoxon.scores` at
        threshold 1, ROI by ROI, over 8 groups: 168 comparisons for stability, 104 for discrimination.
    """
    return read_csv(RESOURCES / "ct_phantom4radiomics_scores.csv")


def load_score_draws(repeats: int, acquisitions: str = "fixed") -> pd.DataFrame:
    """The scores of `load_scores` from random subsamples of as many acquisitions as a study has repeats.

    Parameters
    ----------
    repeats : int
        Acquisitions of each group, at least 2.
    acquisitions : {"fixed", "all"}, optional
        "fixed": of the 19 that all groups have without re-positioning; "all": of all 29.

    Returns
    -------
    DataFrame
        One row per draw and feature, as `statistics.repeats.draws`. More repeats than there are acquisitions are
        brought down to these; column repeats says to how many.

    Raises
    ------
    InputError
        For another word, or repeats that were not drawn.
    """
    kept = read_csv(RESOURCES / "ct_phantom4radiomics_draws.csv")
    kept = kept[kept["acquisitions"] == acquisitions]
    if kept.empty:
        raise InputError(f"measured scores: {acquisitions!r} is not known; choose from {', '.join(ACQUISITIONS)}")
    kept = kept[kept["repeats"] == min(repeats, kept["repeats"].max())]
    if kept.empty:
        raise InputError(f"measured scores: none were drawn of {repeats} of {acquisitions} acquisitions")
    keys = ["repeats", "of", "draw"]
    counts = kept.melt(id_vars=[*keys, "kind", "comparisons"], value_vars=list(STUDY_FEATURES), var_name="feature")
    counts["percent"] = 100 * counts["value"] / counts["comparisons"]
    wide = counts.pivot(index=[*keys, "feature"], columns="kind", values="percent").reset_index()
    order = wide["feature"].map(STUDY_FEATURES.index)
    wide = wide.assign(_order=order).sort_values(["draw", "_order"], ignore_index=True).drop(columns="_order")
    return wide.rename(columns=lambda name: f"{name}_percent" if name in ("stability", "discrimination") else name)


def load_dose_series() -> pd.DataFrame:
    """Mean and SD (n - 1) over repeats of each feature in the dose series of CT4Harmonization-Multicentric.

    Returns
    -------
    DataFrame
        Columns dose_mgy (1, 3, 10), reconstruction (fbp | iterative), roi, tissue_class, feature (all 86), mean, sd, n.
    """
    return _with_classes(read_csv(dose_series.TABLE))


def load_full_table(path: str | Path) -> pd.DataFrame:
    """The full table of CT-Phantom4Radiomics features, in this project's names, values as stored (HU + 1024).

    Parameters
    ----------
    path : str or Path
        The published CSV as it is.

    Returns
    -------
    DataFrame
        Columns scan, group, acquisition (1 to 30, the same one in all groups: `true_acquisition`), repositioned (0 or
        1), roi, tissue_class, n_voxels, 85 features.

    Raises
    ------
    InputError
        If the file is missing, lacks a column, or holds an ROI, a group or values that do not belong.
    """
    raw = _source_table(path, ["scan_id", "group", "class", "mask size"], STUDY_FEATURES, {"class": STUDY_ROIS})
    scan = raw["scan_id"].astype(str).str.extract(r"^(\d{3})-", expand=False)
    if scan.isna().any() or (scan.str[0].astype(int) != raw["group"]).any():
        raise InputError(f"{path}: has a scan_id that does not begin with the digit of its group")
    roi = raw["class"].map(STUDY_ROIS)
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
    return pd.concat([keys, raw[list(STUDY_FEATURES)]], axis="columns")


def true_acquisition(group: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Which of the 30 acquisitions a scan of CT-Phantom4Radiomics reconstructs.

    All groups reconstruct the same acquisitions, but groups 1 and 2 leave out the first and count from the second, and
    group 3 counts some backwards. Found from the ROIs' means, which the groups share but for their reconstruction, and
    held against the masks' places, which are another after each re-positioning (tests/test_measured.py).

    Parameters
    ----------
    group : array_like of int
        1 to 8.
    number : array_like of int
        That in the scan's name, digits 2 and 3.
    """
    group, number = np.asarray(group), np.asarray(number)
    third = np.select(
        [(number >= 11) & (number <= 15), (number >= 16) & (number <= 25)], [number + 10, 36 - number], number
    )
    return np.select([group <= 2, group == 3], [number + 1, third], number)


def load_full_dose_series(path: str | Path) -> pd.DataFrame:
    """The full table of the dose series of CT4Harmonization-Multicentric, in this project's names, HU.

    Parameters
    ----------
    path : str or Path
        The published CSV as it is.

    Returns
    -------
    DataFrame
        Columns dose_mgy, reconstruction (fbp | iterative), repeat (1, 2, ...), roi, tissue_class, 86 features.

    Raises
    ------
    InputError
        If the file is missing, lacks a column, or holds an ROI, a reconstruction or values that do not belong.
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
    """A published table as it is; InputError if it lacks columns, or holds words that are not `known` or no numbers."""
    raw = read_table(path, advice="give the published table as it is")
    if missing := [column for column in (*columns, *features) if column not in raw]:
        raise InputError(f"{path}: lacks {len(missing)} column(s) of the published table, the first {missing[0]!r}")
    for column, words in known.items():
        if strange := sorted(map(str, set(raw[column]) - set(words))):
            raise InputError(f"{path}: {column} {strange[0]!r} is unknown; known are {', '.join(map(str, words))}")
    if not np.isfinite(raw[list(features)].to_numpy(dtype=np.float64)).all():
        raise InputError(f"{path}: has features that are not finite")
    consistency.check(raw, str(path))
    return raw.reset_index(drop=True)


def load_published_top() -> pd.DataFrame:
    """The ten highest-ranked features of the paper's appendix table, in pyradiomics' names.

    Returns
    -------
    DataFrame
        Columns kind (stability | discrimination), source (simulator | phantom), rank, feature.

    References
    ----------
    Flouris et al., Sci. Rep. 12, 2022.
    """
    return read_csv(RESOURCES / "published_top_features.csv")


def _with_classes(table: pd.DataFrame) -> pd.DataFrame:
    table.insert(table.columns.get_loc("roi") + 1, "tissue_class", table["roi"].map(TISSUE_CLASSES))
    return table
