"""Table of features and kinds of change: agreement with intervals, a verdict and a reason in words."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..base.errors import InputError
from ..base.names import enumerated
from ..features.names import family
from ..features.tables import finite_values
from . import ANY_PROTOCOL, EXTRACTION, REPEATS, REPOSITIONING
from .changes import Agreement, Change, agreement, exchanged_icc
from .comparability import SHAPES, grows_with_roi
from .stability_measures import UNVARYING
from .trust import percent, verdicts
from .wilcoxon import repeats_differ

ROBUST, ONE_PROTOCOL, UNDECIDED, AVOID, SIZE = "robust", "one protocol", "undecided", "avoid", "region size"
USES = (ROBUST, ONE_PROTOCOL, UNDECIDED, AVOID, SIZE, UNVARYING)  # in the order of the page
SMALLEST_CHANGE = 0.05  # smaller mean changes (percent, or SD) are 0.0 in texts
WITHIN_PROTOCOL = (REPEATS, REPOSITIONING)  # changes without another setting


def robustness_table(
    table: pd.DataFrame,
    features: Sequence[str],
    pairs: Sequence[Mapping],
    cut_offs: Mapping[str, float],
    *,
    threshold: float = 1.0,
    source: str = "features",
) -> pd.DataFrame:
    """Compute the robustness of every feature against every kind of change.

    Parameters
    ----------
    table : DataFrame
        One row per image and ROI, with columns roi, tissue_class, seed, the columns in `where` of the pairs, and
        `features`.
    pairs : sequence of mapping
        Pairs of settings: kind, relation (see `changes.Change`), first and second, each with label, where
        ({column: value}) and seeds.
    cut_offs : mapping of str to float
        icc: smallest ICC of a robust feature; w_stability_percent.
    threshold : float, optional
        Limit of |W|.

    Returns
    -------
    DataFrame
        One row per feature and kind of change:

        * feature, family, change
        * use: robust (the interval of the ICC is above the cut-off for every change), one protocol (above it for random
          repeats and re-positioning only), avoid (below it for some change), undecided (the others), region size
          (`comparability.grows_with_roi`), or "does not vary"; reason in words. Both are the same in all rows of a
          feature.
        * robust: yes, no or undecided for this change; icc_cut_off; sentence in words
        * pairs, rois, repeats: compared pairs of settings, regions, and fewest repeats of a setting
        * icc, ccc, repeatability (see `changes`), each with _low and _high, the 95 % interval
        * stability_percent, ci95_low, ci95_high, stable, cut_off_percent: the same for W
        * exchanged_percent: control, share of exchanges of regions with an ICC at or above the cut-off
        * change_from, change_to: settings that differ most; change_percent, change_sd: the mean change between them,
          in percent and in SDs between regions
        * icc_of_{class}, ccc_of_{class}, repeatability_of_{class}, stability_of_{class}: differences in this tissue
          class alone

    Raises
    ------
    InputError
        If a setting has no row of an ROI and seed, or values that are not finite.
    """
    changes = _changes(table, features, pairs, source)
    found = _rows_of_kinds(features, changes, cut_offs, threshold)
    uses = {name: _use(rows) for name, rows in found.groupby("feature", sort=False)}
    found.insert(3, "use", found["feature"].map({name: use for name, (use, _) in uses.items()}))
    found.insert(4, "reason", found["feature"].map({name: reason for name, (_, reason) in uses.items()}))
    return found


@dataclass(frozen=True)
class _Changes:
    kinds: dict[str, list[Change]]
    classes: list[str]  # of the regions
    varies: np.ndarray  # whether a feature varies over repeats; False for shape features


def _changes(table: pd.DataFrame, features: Sequence[str], pairs: Sequence[Mapping], source: str) -> _Changes:
    values = finite_values(table, features, source)
    rois = list(dict.fromkeys(table["roi"]))
    class_of = dict(zip(table["roi"], table["tissue_class"], strict=True))
    classes = [class_of[roi] for roi in rois]
    arrays = {}

    def array(setting: Mapping) -> np.ndarray:
        key = setting_key(setting)
        if key not in arrays:
            arrays[key] = _array(table, values, rois, setting, source)
        return arrays[key]

    kinds: dict[str, list[Change]] = {}
    for pair in pairs:
        first, second = pair["first"], pair["second"]
        change = Change(
            pair["kind"], first["label"], second["label"], array(first), array(second), relation=pair["relation"]
        )
        kinds.setdefault(pair["kind"], []).append(change)
    varies = repeats_differ([one.T for one in arrays.values()], features)
    return _Changes(kinds, classes, varies)


def _rows_of_kinds(
    features: Sequence[str], of: _Changes, cut_offs: Mapping[str, float], threshold: float
) -> pd.DataFrame:
    parts = [
        _rows(features, kind, changes, agreement(changes, of.classes, threshold), of.classes, of.varies, cut_offs)
        for kind, changes in of.kinds.items()
    ]
    return _by_feature(pd.concat(parts, ignore_index=True), features)


def _by_feature(found: pd.DataFrame, features: Sequence[str]) -> pd.DataFrame:
    return found.sort_values("feature", key=pd.Index(features).get_indexer, kind="stable", ignore_index=True)


def with_extraction(
    found: pd.DataFrame,
    table: pd.DataFrame,
    pairs: Sequence[Mapping],
    cut_offs: Mapping[str, float],
    *,
    threshold: float = 1.0,
    source: str = "features",
) -> pd.DataFrame:
    """Add rows of EXTRACTION to a robustness table.

    Users choose extraction settings once, so a change of these settings does not enter `use` and `reason`.

    Parameters
    ----------
    found : DataFrame
        From `robustness_table`.
    table, pairs, cut_offs, threshold
        As in `robustness_table`; features that `table` lacks have no row.

    Raises
    ------
    InputError
        As in `robustness_table`.
    """
    features = [feature for feature in found["feature"].unique() if feature in table]
    rows = _rows_of_kinds(features, _changes(table, features, pairs, source), cut_offs, threshold)
    uses = found.drop_duplicates("feature").set_index("feature")
    for place, name in enumerate(("use", "reason"), 3):
        rows.insert(place, name, rows["feature"].map(uses[name]))
    return _by_feature(pd.concat([found, rows], ignore_index=True), list(uses.index))


def acquisition_changes(found: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of a robustness table that enter `use`: all except extraction settings."""
    return found[found["change"] != EXTRACTION].reset_index(drop=True)


def with_protocols(found: pd.DataFrame, stability: pd.DataFrame) -> pd.DataFrame:
    """Replace the columns of W in the rows of ANY_PROTOCOL by `trust.trust_table`, and add its other columns."""
    between = found["change"] == ANY_PROTOCOL
    own = stability.set_index("feature").loc[found.loc[between, "feature"]]
    result = found.copy()
    for name in own.columns.drop("family"):
        if name == "sentence":
            joined = result.loc[between, name].str.cat(own[name].to_numpy(), sep=" By W: ")
            result.loc[between, name] = joined
            continue
        if name not in result:
            result[name] = np.nan
        result.loc[between, name] = own[name].to_numpy()
    return result


def between_protocols(found: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of a robustness table for pairs of protocols: one row per feature."""
    return found[found["change"] == ANY_PROTOCOL].reset_index(drop=True)


def setting_key(setting: Mapping) -> tuple:
    """Return a key that two settings share if they have the same images."""
    return (*sorted(setting["where"].items()), *setting["seeds"])


def setting_rows(table: pd.DataFrame, setting: Mapping) -> np.ndarray:
    """Return which rows of a table with columns seed and those in `where` are of a setting."""
    chosen = table["seed"].isin(setting["seeds"]).to_numpy()
    for column, value in setting["where"].items():
        chosen = chosen & (table[column] == value).to_numpy()
    return chosen


def _array(table: pd.DataFrame, values: np.ndarray, rois: list, setting: Mapping, source: str) -> np.ndarray:
    """Return the values of a setting, shape (features, rois, seeds)."""
    chosen = setting_rows(table, setting)
    wanted = pd.MultiIndex.from_product([rois, setting["seeds"]])
    rows = pd.MultiIndex.from_frame(table.loc[chosen, ["roi", "seed"]])
    if not rows.is_unique or len(missing := wanted.difference(rows)):
        where = ", ".join(f"{column} {value}" for column, value in setting["where"].items())
        what = "two rows" if not rows.is_unique else f"no row of ROI {missing[0][0]}, seed {missing[0][1]}"
        raise InputError(f"{source}: {what} for {where}; extract the features again")
    return values[chosen][rows.get_indexer(wanted)].T.reshape(values.shape[1], len(rois), -1)


def _rows(
    features: Sequence[str],
    kind: str,
    changes: Sequence[Change],
    found: Agreement,
    classes: Sequence[Hashable],
    varies: np.ndarray,
    cut_offs: Mapping[str, float],
) -> pd.DataFrame:
    icc, w = found.measures["icc"], found.measures["w"]
    largest = [changes[pair] for pair in found.largest]
    shifts = kind not in WITHIN_PROTOCOL
    rows = pd.DataFrame(
        {
            "feature": list(features),
            "family": [family(feature) for feature in features],
            "change": kind,
            "robust": np.where(varies, verdicts(icc.low, icc.high, cut_offs["icc"]), UNVARYING),
            "icc_cut_off": float(cut_offs["icc"]),
            "sentence": "",
            "pairs": len(changes),
            "rois": len(classes),
            "repeats": min(min(one.a.shape[-1], one.b.shape[-1]) for one in changes),
            **_columns("icc", found),
            **_columns("ccc", found),
            **_columns("repeatability", found),
            "stability_percent": 100 * w.value,
            "ci95_low": 100 * w.low,
            "ci95_high": 100 * w.high,
            "stable": verdicts(100 * w.low, 100 * w.high, cut_offs["w_stability_percent"]),
            "cut_off_percent": float(cut_offs["w_stability_percent"]),
            "exchanged_percent": _exchanged_percent(exchanged_icc(changes), cut_offs["icc"]),
            "change_from": [one.first if shifts else None for one in largest],
            "change_to": [one.second if shifts else None for one in largest],
            "change_percent": found.percent if shifts else np.nan,
            "change_sd": found.deviations if shifts else np.nan,
            **{
                f"{measure}_of_{name}": found.by_class[measure][name]
                for measure in ("icc", "ccc", "repeatability")
                for name in dict.fromkeys(classes)
            },
            **{f"stability_of_{name}": 100 * found.by_class["w"][name] for name in dict.fromkeys(classes)},
        }
    )
    text = ("feature", "family", "change", "robust", "sentence", "stable", "change_from", "change_to")
    known = ("pairs", "rois", "repeats", "icc_cut_off", "cut_off_percent")
    rows.loc[~varies, [name for name in rows if name not in (*text, *known)]] = np.nan
    rows.loc[~varies, "stable"] = UNVARYING
    rows["sentence"] = [sentence(row) for row in rows.to_dict("records")]
    return rows


def _exchanged_percent(exchanged: np.ndarray, cut_off: float) -> np.ndarray:
    if not exchanged.shape[1]:  # one region
        return np.full(len(exchanged), np.nan)
    return 100 * (exchanged >= cut_off).mean(axis=1)


def _columns(measure: str, found: Agreement) -> dict[str, np.ndarray]:
    one = found.measures[measure]
    return {measure: one.value, f"{measure}_low": one.low, f"{measure}_high": one.high}


def sentence(row: Mapping) -> str:
    """Describe a row of `robustness_table` in words."""
    if row["robust"] == UNVARYING:
        return "Does not vary between the images."
    moved = changed(row)
    return f"{row['change'].capitalize()}: {agreement_text(row)}{f'; {moved}' if moved else ''}."


def agreement_text(row: Mapping) -> str:
    """Return the ICC of a row with its interval."""
    if np.isnan(row["icc"]):
        return "ICC not defined"
    if np.isnan(row["icc_low"]):
        return f"ICC {row['icc']:.2f} (no interval; {row['rois']} regions)"
    return f"ICC {row['icc']:.2f} ({row['icc_low']:.2f} to {row['icc_high']:.2f}; {row['rois']} regions)"


def changed(row: Mapping) -> str:
    """Describe the largest mean change of a row; "" for random repeats and re-positioning."""
    if row["change"] in WITHIN_PROTOCOL or np.isnan(row["change_sd"] if np.isnan(row["change_percent"]) else 0):
        return ""
    if np.isnan(row["change_percent"]):
        change, number, unit = row["change_sd"], f"{abs(row['change_sd']):.1f}", "SD between regions"
    else:
        change, number, unit = row["change_percent"], percent(abs(row["change_percent"])), "%"
    verb = "rises" if change > 0 else "falls"
    if abs(change) < SMALLEST_CHANGE:
        verb, number = "changes", "less than 0.1"
    return f"{verb} by {number} {unit} from {row['change_from']} to {row['change_to']}"


def _use(rows: pd.DataFrame) -> tuple[str, str]:
    """Return use and reason of a feature from its rows."""
    feature = rows["feature"].iloc[0]
    if (rows["robust"] == UNVARYING).all():
        if rows["family"].iloc[0] in SHAPES:
            return UNVARYING, "Depends on the mask only, which is the same in all images."
        return UNVARYING, "Has the same value in all repeats."
    worst = rows.loc[rows["icc"].fillna(-np.inf).idxmin()]
    if grows_with_roi(feature):
        return SIZE, f"Grows with the size of the region: agreement may only show that sizes differ. {_worst(worst)}"
    if (rows["robust"] == "yes").all():
        return ROBUST, f"Above the cut-off for every change. {_worst(worst)}"
    within = rows[rows["change"].isin(WITHIN_PROTOCOL)]
    if len(within) and (within["robust"] == "yes").all():
        return ONE_PROTOCOL, _failures(rows)
    return (AVOID if (rows["robust"] == "no").any() else UNDECIDED), _failures(rows)


def _worst(row: Mapping) -> str:
    moved = changed(row)
    return f"Lowest for {row['change']}: {agreement_text(row)}{f'; {moved}' if moved else ''}."


def _failures(rows: pd.DataFrame) -> str:
    """Describe the changes for which a feature is not or perhaps not robust, with the numbers of the worst."""
    parts = []
    for verdict, text in (("no", "Not robust for"), ("undecided", "Undecided for")):
        failing = rows[rows["robust"] == verdict]
        if len(failing):
            parts.append(f"{text} {enumerated(list(failing['change']))}.")
    failing = rows[rows["robust"] == "no"] if (rows["robust"] == "no").any() else rows
    return " ".join([*parts, _worst(failing.loc[failing["icc"].fillna(-np.inf).idxmin()])])
