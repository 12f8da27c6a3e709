import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.statistics.attribution import attribute

F = [FEATURES[7], FEATURES[3], "original_glcm_Contrast"]  # two first-order ones and a texture
ROIS = ("cyst_1", "normal_1")


def table(offsets, repeats=8, seed=0, spread=1.0, rois=ROIS):
    """Normal repeats about an offset by feature: SD 1 unless said otherwise, their sample mean exactly the offset."""
    rng = np.random.default_rng(seed)
    parts = []
    for roi in rois:
        noise = rng.normal(size=(repeats, len(F)))
        noise = spread * (noise - noise.mean(axis=0)) / noise.std(axis=0, ddof=1)
        parts.append(pd.DataFrame(np.array(offsets) + noise, columns=F).assign(roi=roi, tissue_class=roi))
    return pd.concat(parts, ignore_index=True)


RECORDED = table([0, 0, 0], seed=9)
# Shifts in repeat SDs: 4, 8 and 0.5, of which the first variant leaves 0.5, 4 and 2, the second 2, 6 and 0.5.
VARIANTS = {"baseline": table([4, -8, 0.5]), "noise": table([0.5, -4, 2]), "blur": table([-2, -6, 0.5])}


def test_shares_by_hand():
    found = attribute(VARIANTS, RECORDED, F, resamples=200)
    cells = found.cells.set_index(["variant", "roi", "feature"]).sort_index()
    assert len(cells) == 12
    for roi in ROIS:
        noise, blur = (cells.loc[(name, roi)].loc[F] for name in ("noise", "blur"))
        assert noise["shift_baseline"].tolist() == pytest.approx([4, -8, 0.5])
        assert noise["shift_variant"].tolist() == pytest.approx([0.5, -4, 2])
        assert noise["removed_sd"].tolist() == pytest.approx([3.5, 4, -1.5])
        assert noise["removed_share"].tolist() == pytest.approx([7 / 8, 1 / 2, -3])
        assert noise["missed"].tolist() == [True, True, False]
        assert noise["repaired"].tolist() == [True, False, False] and noise["broken"].tolist() == [False, False, True]
        assert blur["removed_share"].tolist() == pytest.approx([1 / 2, 1 / 4, 0])
        assert not blur[["repaired", "broken"]].any().any()
    assert ((cells["removed_lower"] <= cells["removed_upper"]) & cells["removed_lower"].notna()).all()

    properties = found.properties
    assert properties["family"].tolist() == ["all"] * 2 + ["first order"] * 2 + ["GLCM"] * 2
    first, second = properties.iloc[0], properties.iloc[1]
    columns = ["rank", "variant", "cells", "misses", "repaired", "share_repaired", "broken"]
    assert first[columns].tolist() == [1, "noise", 6, 4, 2, 0.5, 2]
    assert second[columns].tolist() == [2, "blur", 6, 4, 0, 0, 0]
    assert [first["median_removed_share"], second["median_removed_share"]] == pytest.approx([11 / 16, 3 / 8])
    assert first["lower"] <= 0.5 <= first["upper"] and first["share_best"] > 0.9
    assert properties.loc[4:, "share_repaired"].isna().all() and (properties.loc[4:, "misses"] == 0).all()


def test_a_perfect_variant_repairs_everything_and_the_baseline_itself_nothing():
    found = attribute({**VARIANTS, "all": RECORDED, "none": VARIANTS["baseline"]}, RECORDED, F, resamples=200)
    properties = found.properties.query("family == 'all'").set_index("variant")
    assert properties.loc["all", ["rank", "share_repaired", "median_removed_share", "broken"]].tolist() == [1, 1, 1, 0]
    assert properties.loc["none", ["share_repaired", "median_removed_share", "broken"]].tolist() == [0, 0, 0]
    assert properties.loc["none", ["median_removed_lower", "median_removed_upper"]].tolist() == [0, 0]  # drawn alike


def test_what_changes_nothing_repairs_nothing_in_any_resample():
    """Means at the margin: with other repeats the baseline itself comes within it."""
    baseline = table([1.05, -1.1, 1.02])
    found = attribute({"baseline": baseline, "none": baseline}, RECORDED, F, resamples=200).properties
    assert (found.query("misses > 0")[["lower", "upper"]] == 0).all(axis=None)


def test_the_interval_covers_what_repeats_would_give():
    """The true share removed is 1 - 3/6; of 200 trials with 10 repeats, most intervals hold it."""
    rng = np.random.default_rng(4)
    covered = []
    for _ in range(200):
        noise, own = rng.normal(size=(2, 10, 3))
        frames = (
            pd.DataFrame(values, columns=F).assign(roi="cyst_1", tissue_class="cyst")
            for values in (6 + noise, 3 + noise, own)
        )
        baseline, variant, recorded = frames
        cells = attribute({"baseline": baseline, "v": variant}, recorded, F, resamples=200).cells
        covered += list((cells["removed_lower"] <= 0.5) & (cells["removed_upper"] >= 0.5))
    assert 0.88 < np.mean(covered) < 0.97  # percentile intervals of ten repeats are a little narrow


@settings(max_examples=15, deadline=None)
@given(scale=st.floats(0.01, 100), offset=st.floats(-50, 50), seed=st.integers(0, 5))
def test_units_change_nothing(scale, offset, seed):
    def moved(part):
        return part.assign(**{feature: -scale * part[feature] + offset for feature in F})

    plain = attribute(VARIANTS, RECORDED, F, resamples=20, seed=seed)
    changed = attribute({k: moved(v) for k, v in VARIANTS.items()}, moved(RECORDED), F, resamples=20, seed=seed)
    columns = ["removed_share", "removed_lower", "removed_upper", "removed_sd"]
    assert np.allclose(plain.cells[columns], changed.cells[columns], rtol=1e-5, atol=1e-6)
    pd.testing.assert_frame_equal(plain.properties, changed.properties, rtol=1e-5, atol=1e-6)


def test_constants_of_the_recording():
    """Without a unit every difference is a miss, and its repair is to be the same."""
    recorded = RECORDED.assign(**{F[0]: 3.0})
    variants = {"baseline": VARIANTS["baseline"], "v": VARIANTS["noise"].assign(**{F[0]: 3.0})}
    cells = attribute(variants, recorded, F[:1], resamples=50).cells
    assert np.isinf(cells["shift_baseline"]).all() and cells["repaired"].all() and (cells["removed_share"] == 1).all()
    same = {name: part.assign(**{F[0]: 3.0}) for name, part in variants.items()}
    cells = attribute(same, recorded, F[:1], resamples=50).cells
    assert not cells["missed"].any() and cells["removed_share"].isna().all() and not cells["broken"].any()


@pytest.mark.parametrize(
    "variants, options, message",
    [
        ({"noise": VARIANTS["noise"]}, {}, "variants are noise; give baseline and at least one more"),
        ({"baseline": VARIANTS["noise"]}, {}, "variants are baseline; give baseline and at least one more"),
        (VARIANTS, {"baseline": "start"}, "give start and at least one more"),
        (VARIANTS, {"resamples": 0}, "resamples 0 must be positive"),
        (VARIANTS | {"x": table([0, 0, 0], repeats=5)}, {}, "features of x: 5 images of ROI cyst_1, baseline has 8"),
        (VARIANTS | {"x": table([0, 0, 0], rois=["cyst_1"])}, {}, "the simulated features lack the ROI normal_1"),
        (VARIANTS | {"x": VARIANTS["blur"].drop(columns=F[1])}, {}, f"features of x: lack {F[1]}"),
    ],
)
def test_bad_input_is_one_clear_line(variants, options, message):
    with pytest.raises(InputError) as caught:
        attribute(variants, RECORDED, F, **options)
    assert message in str(caught.value) and "\n" not in str(caught.value)
