"""Principal components of the features, and the separation of tissue classes in the plane of the first two.

As in Flouris et al., Sci. Rep. 2022, with simulated and measured features. Features are standardized first, because
they span many orders of magnitude.
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
# Columns that only one of the two sets has.
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
    """Project simulated and measured features onto the first two principal components.

    Parameters
    ----------
    simulated : DataFrame
        Columns ACQUISITION, roi, tissue_class and features.
    measured : DataFrame, optional
        Columns group, roi, tissue_class and features, optionally condition. Features that only one table has are
        ignored.
    fit_on : {"simulated", "measured", "pooled"}, optional
        Set that the components are fitted on.
    standardise : {"each", "together"}, optional
        Mean and SD that standardize the features. "each": of each set, which hides offsets between the sets (2D and 3D
        features, voxel size). "together": of the set fitted on.

    Returns
    -------
    DataFrame
        Columns source, ACQUISITION, group, roi, tissue_class, condition (if measured has it), pc1, pc2,
        explained_pc1_percent and explained_pc2_percent (of the set fitted on). The largest loading of each component is
        positive.

    Raises
    ------
    InputError
        For an unknown choice, a fit on measured features without a table of them, or values that are not finite.
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
            f"pca: {basis.shape[0]} rows and {basis.shape[1]} features; two components need at least two of each"
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
        part = part.astype({name: dtype for name, dtype in NULLABLE.items() if name in columns})
        parts.append(part.assign(pc1=scores[:, 0], pc2=scores[:, 1]))
    result = pd.concat(parts, ignore_index=True)
    return result.assign(explained_pc1_percent=explained[0], explained_pc2_percent=explained[1])


def separability(points: pd.DataFrame, name: str) -> pd.DataFrame:
    """Cross-validated accuracy of a linear discriminant for the tissue class in the plane of the components.

    Each fold omits one setting (protocol and noise level, or measured group), so that no point is classified with the
    help of repeats of its own setting. With a single setting, each fold omits one repeat (seed).

    Parameters
    ----------
    points : DataFrame
        From `project`.
    name : str
        Name of the analysis, for the column pca.

    Returns
    -------
    DataFrame
        One row per source: pca, source, left_out (setting | repeat), accuracy (0 to 1), largest_class (accuracy of
        always choosing the most frequent class), n (points).

    Raises
    ------
    InputError
        For fewer than two classes or two folds, or if a fold has no more points than there are classes.
    """
    rows = []
    for source, part in points.groupby("source", sort=False):
        classes = part["tissue_class"].to_numpy()
        setting = part.groupby(["protocol", "noise", "group"], dropna=False).ngroup()
        repeat = part.groupby("seed", dropna=False).ngroup()
        left_out, blocks = ("setting", setting) if setting.nunique() > 1 else ("repeat", repeat)
        if len(np.unique(classes)) < 2 or blocks.nunique() < 2:
            raise InputError(
                f"pca {name}: {source} points need at least two tissue classes, and two settings or repeats"
            )
        if len(part) - blocks.value_counts().max() <= len(np.unique(classes)):
            raise InputError(
                f"pca {name}: without one {left_out} there are no more {source} points than tissue classes; "
                "use more repeats or settings"
            )
        predicted = cross_val_predict(
            LinearDiscriminantAnalysis(), part[["pc1", "pc2"]].to_numpy(), classes, groups=blocks, cv=LeaveOneGroupOut()
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
