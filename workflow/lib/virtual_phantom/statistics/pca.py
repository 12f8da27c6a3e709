"""Principal components of the features, and how well tissue classes separate in their plane.

Flouris et al., Sci. Rep. 2022: the first two components of all features, simulated over measured. Features
are standardised first, as they span many orders of magnitude.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.decomposition import PCA
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict
from sklearn.preprocessing import StandardScaler

from ..base.errors import InputError
from ..features.names import features_of
from ..features.tables import ACQUISITION, finite_values

FIT_ON = ("simulated", "measured", "pooled")
STANDARDISE = ("each", "together")
# Columns that one of the two sets lacks.
NULLABLE = {
    "protocol": "string",
    "algorithm": "string",
    "projections": "Int64",
    "noise": "string",
    "noise_level": "Float64",
    "seed": "Int64",
    "group": "Int64",
    "condition": "string",
}


def project(
    simulated: pd.DataFrame,
    measured: pd.DataFrame | None = None,
    *,
    fit_on: str = "simulated",
    standardise: str = "each",
) -> pd.DataFrame:
    """Simulated and measured features in the plane of the first two principal components.

    Parameters
    ----------
    simulated : DataFrame
        Rows with ACQUISITION, roi, tissue_class and features.
    measured : DataFrame, optional
        Rows with group, roi, tissue_class and features; features of only one table are left out.
    fit_on : {"simulated", "measured", "pooled"}, optional
        Whose components.
    standardise : {"each", "together"}, optional
        "each": each set by its own mean and SD, so that offsets of a whole set (2D against 3D, voxel size) do not show
        and only the layout is compared; "together": both by those of the set fitted on.

    Returns
    -------
    DataFrame
        Rows of source, ACQUISITION, group, roi, tissue_class, condition where measured rows name theirs, pc1, pc2,
        explained_pc1_percent and explained_pc2_percent (of the set fitted on). The sign of an axis is such that its
        largest loading is positive.

    Raises
    ------
    InputError
        For an unknown choice, a measured fit without measured data, or values that are not finite.
    """
    for key, value, allowed in (("fit_on", fit_on, FIT_ON), ("standardise", standardise, STANDARDISE)):
        if value not in allowed:
            raise InputError(f"pca.{key}: {value!r} is not known; choose from {', '.join(allowed)}")
    if measured is None and fit_on != "simulated":
        raise InputError(f"pca.fit_on: {fit_on!r} needs measured features; choose simulated")
    tables = {"simulated": simulated} if measured is None else {"simulated": simulated, "measured": measured}
    features = [feature for feature in features_of(simulated) if all(feature in table for table in tables.values())]
    values = {source: finite_values(table, features, f"{source} features") for source, table in tables.items()}
    fitted = list(values) if fit_on == "pooled" else [fit_on]
    if standardise == "each":
        values = {source: StandardScaler().fit_transform(array) for source, array in values.items()}
    else:
        scaler = StandardScaler().fit(np.concatenate([values[source] for source in fitted]))
        values = {source: scaler.transform(array) for source, array in values.items()}
    basis = np.concatenate([values[source] for source in fitted])
    if min(basis.shape) < 2:
        raise InputError(
            f"pca: {basis.shape[0]} rows of {basis.shape[1]} features; two components need at least two each"
        )
    model = PCA(n_components=2, svd_solver="full").fit(basis)
    loadings = model.components_
    largest = np.argmax(np.abs(loadings), axis=1)
    signs = np.sign(loadings[np.arange(2), largest])
    explained = 100 * model.explained_variance_ratio_
    columns = ["source", *ACQUISITION, "group", "roi", "tissue_class"]
    if measured is not None and "condition" in measured:
        columns.append("condition")
    parts = []
    for source, table in tables.items():
        scores = model.transform(values[source]) * signs
        part = table.assign(source=source).reindex(columns=columns)
        part = part.astype({name: of for name, of in NULLABLE.items() if name in columns})
        parts.append(part.assign(pc1=scores[:, 0], pc2=scores[:, 1]))
    result = pd.concat(parts, ignore_index=True)
    return result.assign(explained_pc1_percent=explained[0], explained_pc2_percent=explained[1])


def separability(points: pd.DataFrame, name: str) -> pd.DataFrame:
    """How many points a linear discriminant in the plane of components puts into the right tissue class.

    Cross-validated by leaving out one setting at a time (protocol and noise level; a measured group), so that
    no point is judged by repeats of its own setting; with a single setting, one repeat (seed) at a time.

    Parameters
    ----------
    points : DataFrame
        From `project`.
    name : str
        Of the analysis, copied into the column pca.

    Returns
    -------
    DataFrame
        One row per source: pca, source, left_out (setting | repeat), accuracy (0 to 1), largest_class (what guessing
        the commonest class would reach), n (points).

    Raises
    ------
    InputError
        For fewer than two classes, if nothing can be left out, or if what remains is not more points than classes.
    """
    rows = []
    for source, part in points.groupby("source", sort=False):
        classes = part["tissue_class"].to_numpy()
        setting = part.groupby(["protocol", "noise", "group"], dropna=False).ngroup()
        repeat = part.groupby("seed", dropna=False).ngroup()
        left_out, blocks = ("setting", setting) if setting.nunique() > 1 else ("repeat", repeat)
        if len(np.unique(classes)) < 2 or blocks.nunique() < 2:
            raise InputError(
                f"pca {name}: {source} points need at least two tissue classes and two settings or repeats"
            )
        if len(part) - blocks.value_counts().max() <= len(np.unique(classes)):
            raise InputError(
                f"pca {name}: with one {left_out} left out, {source} points are no more than the tissue classes; "
                "give more repeats or settings"
            )
        predicted = cross_val_predict(
            LinearDiscriminantAnalysis(),
            part[["pc1", "pc2"]].to_numpy(),
            classes,
            groups=blocks,
            cv=LeaveOneGroupOut(),
        )
        rows.append(
            {
                "pca": name,
                "source": source,
                "left_out": left_out,
                "accuracy": float(np.mean(predicted == classes)),
                "largest_class": float(part["tissue_class"].value_counts(normalize=True).max()),
                "n": len(part),
            }
        )
    return pd.DataFrame(rows)
