"""A simulated feature table of two protocols and two doses, with its pairs of settings and its robustness table."""

import numpy as np
import pandas as pd

from virtual_phantom.statistics import ANY_PROTOCOL, EXTRACTION, REPEATS, REPOSITIONING, robustness, trust

ROBUST = "original_firstorder_Mean"  # far larger differences between regions than between images
DOSE = "original_firstorder_Entropy"  # rises by 8 % at low dose
NOISE = "original_glcm_Idn"  # noise alone
SIZED = "original_firstorder_Energy"
SHAPE = "original_shape_Sphericity"
FEATURES = (ROBUST, DOSE, NOISE, SIZED, SHAPE)
ROIS = {"cyst_1": "cyst", "cyst_2": "cyst", "liver_1": "liver", "liver_2": "liver", "met_1": "met", "met_2": "met"}
REPEATS_EACH = 6
CUT_OFFS = {"w_stability_percent": 50.0, "icc": 0.75, "ccc": 0.9, "cv": 0.1, "qcd": 0.067}


def feature_table(seed=0):
    rng = np.random.default_rng(seed)
    level = np.arange(len(ROIS))
    rows = []
    for protocol in ("thin", "thick"):
        for noise in ("high", "low"):
            for repeat in range(REPEATS_EACH):
                values = {
                    ROBUST: 100.0 + 50 * level + rng.normal(size=len(ROIS)),
                    DOSE: 4 + 0.04 * level + 0.004 * rng.normal(size=len(ROIS)) + 0.328 * (noise == "low"),
                    NOISE: rng.normal(10, 1, size=len(ROIS)),
                    SIZED: 1000.0 * (level + 1) + rng.normal(size=len(ROIS)),
                    SHAPE: 0.5 + 0.1 * level,
                }
                rows.append(
                    pd.DataFrame(
                        {"protocol": protocol, "noise": noise, "seed": repeat, "roi": list(ROIS)}
                        | {"tissue_class": list(ROIS.values()), "n_voxels": 500, "grey_levels": 9, **values}
                    )
                )
    return pd.concat(rows, ignore_index=True)


def setting(protocol, noise, label, seeds=range(4)):
    return {"label": label, "where": {"protocol": protocol, "noise": noise}, "seeds": list(seeds)}


def setting_pairs():
    found = []
    for protocol in ("thin", "thick"):
        for noise in ("high", "low"):
            one = setting(protocol, noise, f"{protocol}, {noise}")
            moved = setting(protocol, noise, "re-positioned", (4, 5))
            found.append({"kind": REPEATS, "first": one, "second": one, "relation": "repeats"})
            found.append({"kind": REPOSITIONING, "first": one, "second": moved, "relation": "independent"})
        ends = (setting(protocol, noise, label) for noise, label in (("high", "10 mGy"), ("low", "3 mGy")))
        found.append(dict(zip(("kind", "relation", "first", "second"), ("dose", "independent", *ends), strict=True)))
    ends = [setting(protocol, "high", protocol, range(6)) for protocol in ("thin", "thick")]
    found.append({"kind": ANY_PROTOCOL, "first": ends[0], "second": ends[1], "relation": "paired"})
    return found


def robustness_table(table=None):
    """The table trust.csv of the study."""
    table = feature_table() if table is None else table
    compared = table[table["noise"] == "high"]
    compared = compared.assign(group=compared["protocol"].map({"thin": 1, "thick": 2}))
    stability = trust.trust_table(compared, FEATURES, {1: "a", 2: "b"}, CUT_OFFS["w_stability_percent"])
    found = robustness.robustness_table(table, FEATURES, setting_pairs(), CUT_OFFS)
    return robustness.with_protocols(found, stability)


def extracted_table():
    """Features of thin, high with two extraction settings: the other one doubles NOISE; shapes are not extracted."""
    own = feature_table()
    own = own[(own["protocol"] == "thin") & (own["noise"] == "high")].drop(columns=SHAPE)
    return pd.concat([own.assign(setting="study"), own.assign(setting="bin_width_10", **{NOISE: 2 * own[NOISE]})])


def extraction_pairs():
    ends = [
        {"label": name, "where": {"protocol": "thin", "noise": "high", "setting": name}, "seeds": list(range(4))}
        for name in ("study", "bin_width_10")
    ]
    return [{"kind": EXTRACTION, "first": ends[0], "second": ends[1], "relation": "paired"}]
