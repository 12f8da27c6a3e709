"""Figures of tables: every row is drawn, numbers are correct, and names are the user's."""

import itertools

import matplotlib
import numpy as np
import pandas
import pytest
from figure_checks import assert_text_fits, texts
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex
from matplotlib.markers import MarkerStyle
from scipy.stats import hypergeom

from virtual_phantom.base.errors import InputError
from virtual_phantom.figures import noise_calibration, pca, stability_discrimination, style
from virtual_phantom.figures import overlap as overlap_figure
from virtual_phantom.statistics.controls import headline
from virtual_phantom.statistics.noise import EVERY_ROI


def listed(figure):
    """Names of the numbered features, in the order of their numbers."""
    words = [text.get_text() for text in figure.texts]
    return words[words.index("feature") + 1 : words.index("feature") + 1 + words[1:].index("feature")]


def points(axes):
    return [np.asarray(collection.get_offsets()) for collection in axes.findobj(PathCollection)]


def test_text_is_at_least_seven_points_and_not_cut_off(calibration, stability, controls, draws, overlap, make_pca):
    scores = {"repeats": 10, "sd": (0.25, 0.35), "noise": {"dose10": 1.24e-6}}
    for figure in (
        stability_discrimination.draw(stability, 1.0, draws, controls=controls, **scores),
        stability_discrimination.draw(stability, 1.0, controls=controls, **scores),
        noise_calibration.draw(calibration, {"main": 1e-4}, [("1 mGy", 674), ("10 mGy", 228)]),
        stability_discrimination.draw(stability, 1.0, draws, **scores),
        stability_discrimination.draw(stability, 1.0),
        stability_discrimination.draw(stability, 1.0, intervals=stability.assign(ci95_low=0.0, ci95_high=99.0)),
        overlap_figure.draw(overlap),
        pca.draw(make_pca(), "SIRT"),
        pca.draw(make_pca(measured=60)),
    ):
        assert_text_fits(figure)


# Noise calibration


def line(slope, intercept, levels, protocol="sirt_450", scatter=0.0):
    levels = np.asarray(levels)
    variance = intercept + slope * levels + scatter
    return pandas.DataFrame(
        {
            "protocol": protocol,
            "noise": "n",
            "noise_level": levels,
            "repeats": 10,
            "roi": EVERY_ROI,
            "variance_hu2": variance,
            "standard_error": 1.0,
        }
    )


def test_fit_and_crossings_in_closed_form():
    """Variance 50 + 2e6 A: 250 HU^2 is reached at A = 1e-4, 650 HU^2 at 3e-4, 40 HU^2 at no positive A."""
    table = line(2e6, 50, [0.5e-4, 1e-4, 2e-4])
    figure = noise_calibration.draw(table, {"study": 1e-4}, [("high", 250.0), ("low", 650.0), ("never", 40.0)])
    words = texts(figure)
    assert "fit: 200 HU² · A/10⁻⁴ + 50 HU², R² = 1.0000" in words
    assert "measured high: 250 HU², reached at A = 1 ×10⁻⁴" in words
    assert "measured low: 650 HU², reached at A = 3 ×10⁻⁴" in words
    assert "measured never: 40 HU², not reached" in words
    assert "level of the study: A = 1 ×10⁻⁴ (study)" in words
    assert "variance over repeats, all ROIs (HU²)" in words and "noise level A = 1/I₀ (10⁻⁴)" in words
    assert figure.axes[0].get_xlim()[1] > 3


def test_measured_variance_is_compared_with_the_same_quantity_of_its_roi():
    """Among the voxels of `cyst_1`, 100 + 1e6 A reaches 250 HU^2 at 1.5e-4; others have other values."""
    table = line(2e6, 50, [0.5e-4, 1e-4, 2e-4])
    inside = table.assign(roi="cyst_1", spatial_variance_hu2=100 + 1e6 * table["noise_level"], standard_error=np.nan)
    both = pandas.concat([table, inside])
    figure = noise_calibration.draw(both, None, [("x", 250.0)], "cyst_1", noise_calibration.AMONG_VOXELS)
    words = texts(figure)
    assert "measured x: 250 HU², reached at A = 1.5 ×10⁻⁴" in words
    assert "variance among voxels, cyst 1 (HU²)" in words


def test_r_squared_of_three_points():
    """Points (1, 1), (2, 3), (3, 2) x 1e-4: slope 0.5e4, intercept 1, R2 = 1 - 1.5/2 = 0.25."""
    table = line(0, 0, [1e-4, 2e-4, 3e-4])
    table["variance_hu2"] = [1.0, 3.0, 2.0]
    assert "fit: 0.5 HU² · A/10⁻⁴ + 1 HU², R² = 0.2500" in texts(noise_calibration.draw(table))


def test_only_rows_of_all_rois_are_fitted(calibration):
    alone = calibration[calibration["roi"] == EVERY_ROI]
    assert sorted(texts(noise_calibration.draw(calibration))) == sorted(texts(noise_calibration.draw(alone)))
    assert sum(text.startswith("fit: ") for text in texts(noise_calibration.draw(calibration))) == 2  # legend


def test_bad_calibration_tables_are_rejected(calibration):
    with pytest.raises(InputError, match="no rows"):
        noise_calibration.draw(calibration[calibration["roi"] != EVERY_ROI])
    with pytest.raises(InputError, match="no rows"):
        noise_calibration.draw(calibration.iloc[:0])
    with pytest.raises(InputError, match="at least two"):
        noise_calibration.draw(calibration[calibration["noise_level"] == 1e-4])
    with pytest.raises(InputError, match="variance_hu2 is not a finite number"):
        noise_calibration.draw(calibration.assign(variance_hu2=np.nan))


# Stability and discriminative power


def test_every_feature_is_drawn(stability, draws):
    figure = stability_discrimination.draw(stability, 1.0, draws)
    families = sorted(set(stability["family"]))
    one = dict(
        zip(
            families,
            (style.marker_area(marker, stability_discrimination.POINT) for marker in style.MARKERS),
            strict=False,
        )
    )
    colours = dict(zip(map(matplotlib.colors.to_hex, style.ON_WHITE), families, strict=False))
    for axes, total in zip(figure.axes, (86, 85), strict=True):
        (drawn,) = axes.findobj(PathCollection)
        named = [colours[matplotlib.colors.to_hex(colour)] for colour in drawn.get_facecolors()]
        counts = drawn.get_sizes() / [one[family] for family in named]
        assert counts == pytest.approx(counts.round()) and counts.sum() == pytest.approx(total)
        shapes = {family: MarkerStyle(marker) for family, marker in zip(families, style.MARKERS, strict=False)}
        for family, path in zip(named, drawn.get_paths(), strict=True):
            expected = shapes[family].get_path().transformed(shapes[family].get_transform())
            assert np.array_equal(path.vertices, expected.vertices)
        assert f"{total} features" in axes.get_title()
    words = texts(figure)
    assert "stability: pairs of groups with |W| < 1 (%)" in words
    assert "discriminative power: pairs across classes with |W| > 1 (%)" in words
    assert {"First order", "GLCM", "GLDM", "GLRLM", "GLSZM"} <= set(words)


def test_features_with_equal_values_are_one_larger_marker():
    table = pandas.DataFrame(
        {
            "feature": ["a", "b", "c"],
            "family": "glcm",
            "stability_percent": [5.0, 5, 9],
            "discrimination_percent": [80.0, 80, 90],
        }
    )
    (drawn,) = stability_discrimination.draw(table, 1.0).axes[0].findobj(PathCollection)
    size = dict(zip(map(tuple, drawn.get_offsets()), drawn.get_sizes(), strict=True))
    assert list(size) == [(5, 80), (9, 90)]  # the large marker first, at the bottom
    assert size[5, 80] == pytest.approx(2 * size[9, 90])


def test_means_and_best_features():
    table = pandas.DataFrame(
        {
            "feature": [f"original_glcm_F{index}" for index in range(7)],
            "family": "glcm",
            "stability_percent": [0.0, 10, 20, 30, 40, 50, 60],
            "discrimination_percent": [100.0] * 7,
        }
    )
    figure = stability_discrimination.draw(table, 1.5)
    assert figure.axes[0].get_title(loc="left").splitlines()[1:] == ["stable: 30.0 %", "discriminated: 100.0 %"]
    assert listed(figure) == ["GLCM F6", "GLCM F5", "GLCM F4", "GLCM F3", "GLCM F2"]
    assert "stability: pairs of groups with |W| < 1.5 (%)" in texts(figure)


def test_numbered_features_have_their_stability_interval(stability):
    chosen = stability.set_index("feature").loc[stability_discrimination.best(stability)]
    ends = {"ci95_low": stability["stability_percent"] * 0.5, "ci95_high": stability["stability_percent"] + 10}
    intervals = stability[["feature"]].assign(**ends)
    figure = stability_discrimination.draw(stability, 1.0, intervals=intervals)
    (bars,) = figure.axes[0].findobj(LineCollection)
    drawn = sorted((line[0][0], line[1][0]) for line in bars.get_segments())
    value = chosen["stability_percent"].to_numpy()
    assert np.allclose(drawn, sorted(zip(value * 0.5, value + 10, strict=True)))
    assert [text for text in texts(figure) if " to " in text] == [f"{x / 2:.0f} to {x + 10:.0f} %" for x in value]
    # One repeat per group gives no interval.
    none = stability_discrimination.draw(stability, 1.0, intervals=intervals.assign(ci95_low=np.nan))
    assert not [text for text in texts(none) if " to " in text]


def test_numbers_label_the_same_feature_in_both_panels(stability, draws):
    """The measured scores are those of `stability` in reverse order, so each panel has its own best features."""
    reverse = draws.assign(**{name: draws[name].to_numpy()[::-1] for name in stability_discrimination.SCORES})
    figure = stability_discrimination.draw(stability, 1.0, reverse)
    means = reverse.groupby("feature", as_index=False)[stability_discrimination.SCORES].mean()
    expected = list(dict.fromkeys(stability_discrimination.best(stability) + stability_discrimination.best(means)))
    assert listed(figure) == [style.feature_label(name) for name in expected] and len(expected) > 5
    assert_text_fits(figure)
    for axes, scores in zip(figure.axes, (stability, means), strict=True):
        numbers = [text for text in axes.texts if text.get_text()[0].isdigit()]
        assert sorted(", ".join(text.get_text() for text in numbers).split(", "), key=int) == [
            str(number) for number in range(1, 1 + len(expected))
        ]
        where = axes.transData.transform(scores.set_index("feature").loc[expected, stability_discrimination.SCORES])
        for text in numbers:
            near = [where[int(number) - 1] for number in text.get_text().split(", ")]
            label = axes.transData.transform(text.get_position())
            assert np.linalg.norm(np.mean(near, axis=0) - label) < 40 * style.DOTS_PER_INCH / 72


def test_stability_without_discrimination_is_drawn_by_family(stability):
    figure = stability_discrimination.draw(
        stability.assign(discrimination_percent=np.nan), 1.0, repeats=3, sd=(1.0, np.nan)
    )
    (axes,) = figure.axes
    assert_text_fits(figure)
    assert [text.get_text() for text in axes.get_yticklabels()] == ["First order", "GLCM", "GLDM", "GLRLM", "GLSZM"]
    (drawn,) = axes.findobj(PathCollection)
    rows = np.unique(drawn.get_offsets()[:, 1])
    assert rows.tolist() == [0, 1, 2, 3, 4] and not any("discr" in text for text in texts(figure))
    title = f"Simulated: 86 features, 3 repeats per group\nstable: {stability['stability_percent'].mean():.1f} ± 1.0 %"
    assert axes.get_title(loc="left") == title


def test_both_panels_state_their_repeats_and_spreads(stability, draws):
    simulated, measured = (
        axes.get_title()
        for axes in stability_discrimination.draw(stability, 1.0, draws, repeats=10, sd=(0.25, 1.5)).axes
    )
    stable, difference = stability["stability_percent"].mean(), stability["discrimination_percent"].mean()
    assert simulated.splitlines() == [
        "Simulated: 86 features, 10 repeats per group",
        f"stable: {stable:.1f} ± 0.2 %",
        f"discriminated: {difference:.1f} ± 1.5 %",
    ]
    stable, difference = (draws[f"{kind}_percent"].mean() for kind in ("stability", "discrimination"))
    # Means of the two realizations differ by 2: SD sqrt(2), for 4 of 12 repeats divided by sqrt(1 - 1 / 3)
    assert measured.splitlines() == [
        "Measured: 85 features, 4 repeats per group",
        f"stable: {stable:.1f} ± 1.7 %",
        f"discriminated: {difference:.1f} ± 1.7 %",
    ]
    assert "±" not in stability_discrimination.draw(stability, 1.0, draws[draws["draw"] == 1]).axes[1].get_title()


def test_titles_state_the_controls_as_the_index_page(stability, controls, draws):
    ten = draws.assign(repeats=10)
    own = [stability[f"{kind}_percent"].mean() for kind in ("stability", "discrimination")]
    for name, value in zip(("protocols", "different classes"), own, strict=True):
        controls.loc[controls["control"] == name, "percent"] = value
    simulated, measured = (
        axes.get_title()
        for axes in stability_discrimination.draw(stability, 1.0, ten, repeats=10, controls=controls).axes
    )
    words = headline(controls)
    assert words["discrimination"].endswith("(pairs of one tissue class: 89.0 %; by chance: 31.5 %)")
    expected = f"stable: {words['stability']} discriminated: {words['discrimination']}"
    assert " ".join(simulated.split()).endswith(expected)
    assert measured.count("by chance") == 2 and "by chance: 31.5 %" in measured and "tissue class" not in measured
    # Chance depends on the number of repeats.
    other = stability_discrimination.draw(stability, 1.0, ten, repeats=3, controls=controls).axes[1].get_title()
    assert "chance" not in other
    controls.loc[controls["control"] == "same class", "percent"] = np.nan
    (axes,) = stability_discrimination.draw(stability, 1.0, repeats=10, controls=controls).axes
    assert "no control of one tissue class" in " ".join(axes.get_title(loc="left").split())


def test_user_measured_scores_have_families(stability, draws):
    """As from repeats.score_draws; the scores shipped with the library have no families."""
    family = stability.set_index("feature")["family"]
    user_scores, stored = (
        stability_discrimination.draw(stability, 1.0, of).axes[1]
        for of in (draws.assign(family=draws["feature"].map(family)), draws)
    )
    assert user_scores.get_title() == stored.get_title()


def test_noise_level_is_stated(stability):
    words = " ".join(texts(stability_discrimination.draw(stability, 1.0, noise={"dose10": 1.24e-6})))
    assert "Larger markers: features with equal scores. Noise level dose10 (A = 1.24 ×10⁻⁶)." in words
    assert style.noise_levels({"a": 2e-4, "met": None}) == "noise levels a (A = 2 ×10⁻⁴), met"


def test_numbers_avoid_features():
    """Features lie at the default positions of the numbers, which then move."""
    table = pandas.DataFrame(
        {
            "feature": list("abcdefg"),
            "family": "glcm",
            "stability_percent": [50.0, 52, 52, 10, 10, 12, 90],
            "discrimination_percent": [90.0, 92, 88, 20, 30, 20, 91],
        }
    )
    figure = stability_discrimination.draw(table, 1.0)
    assert_text_fits(figure)
    (axes,) = figure.axes
    numbers = [text for text in axes.texts if text.get_text()[0].isdigit() and "  " not in text.get_text()]
    boxes = [text.get_window_extent() for text in numbers]
    assert sorted(", ".join(text.get_text() for text in numbers).split(", ")) == list("12345")
    for x, y in axes.transData.transform(table[["stability_percent", "discrimination_percent"]]):
        assert not any(box.contains(x, y) for box in boxes)
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_almost_coincident_features_share_a_label():
    table = pandas.DataFrame(
        {
            "feature": list("abc"),
            "family": "glcm",
            "stability_percent": [50.0, 50.5, 4],
            "discrimination_percent": [90.0, 90, 60],
        }
    )
    words = texts(stability_discrimination.draw(table, 1.0))
    assert "1, 2" in words and "3" in words


def test_bad_stability_tables_are_rejected(stability, draws):
    with pytest.raises(InputError, match="no rows"):
        stability_discrimination.draw(stability.iloc[:0], 1.0)
    with pytest.raises(InputError, match="share no feature"):
        stability_discrimination.draw(stability, 1.0, draws.assign(feature="unheard_of"))


# Overlap


def test_overlap_draws_both_curves_and_their_bands(overlap):
    figure = overlap_figure.draw(overlap.sample(frac=1, random_state=1))
    assert [axes.get_title() for axes in figure.axes] == ["Stability", "Discriminative power"]
    assert all({overlap_figure.BAND, overlap_figure.BELOW} <= set(texts(axes)) for axes in figure.axes)
    for axes, kind in zip(figure.axes, ("stability", "discrimination"), strict=True):
        drawn = [line.get_xydata() for line in axes.lines]
        for column in (f"overlap_{kind}_percent", f"expected_{kind}_percent"):
            assert any(np.array_equal(line, overlap[["percent", column]].to_numpy()) for line in drawn)
        assert axes.get_xlabel() == "length of both lists (% of the features)"
    # 43 of 86: 95 % of random choices share 17 to 26, 39.5 to 60.5 % (hypergeometric distribution)
    band = figure.axes[1].collections[1].get_paths()[0].vertices
    at_half = np.unique(band[np.isclose(band[:, 0], 50), 1])
    assert at_half == pytest.approx(100 * np.array(hypergeom(86, 43, 43).interval(0.95)) / 43)
    bars = figure.axes[0].containers[0].lines[2][0].get_segments()
    sd = overlap.set_index("percent")["overlap_stability_sd"]
    assert len(bars) >= 20
    for (x, bottom), (_, top) in bars:
        assert (top - bottom) / 2 == pytest.approx(sd[x])
    assert "features in both lists (% of the length)" in texts(figure)
    areas = {"area_stability": 0.84, "area_stability_expected": 0.54, "area_stability_upper": 0.74}
    title = overlap_figure.draw(overlap.assign(**areas)).axes[0].get_title()
    assert title == "Stability\narea 0.84 (by chance: 0.54, 97.5 % of lists < 0.74)"
    with pytest.raises(InputError, match="no rows"):
        overlap_figure.draw(overlap.iloc[:0])


# Principal components


@pytest.mark.parametrize(
    "names",
    [
        ("aorta",),
        ("liver_1", "liver_2", "spleen_1", "muscle_1"),
        tuple(f"roi_{index}" for index in range(18)),
    ],
)
@pytest.mark.parametrize("measured", [0, 3])
def test_a_marker_for_every_row(make_pca, names, measured):
    table = make_pca(names, measured)
    figure = pca.draw(table, "title")
    assert_text_fits(figure)
    for axes, rows in zip(figure.axes, (table, table[table["source"] == "simulated"]), strict=True):
        drawn = np.concatenate(points(axes))
        assert sorted(map(tuple, drawn)) == sorted(map(tuple, rows[["pc1", "pc2"]].to_numpy()))
    words = texts(figure)
    assert {style.label(name) for name in table["tissue_class"]} <= set(words)
    assert ({style.label(name) for name in names} <= set(words)) or len(names) > pca.MOST_NAMED
    assert "PC 1 (61.2 % of variance)" in words and "PC 2 (17.5 % of variance)" in words
    assert {f"SIRT {count}: {count} projections" for count in range(150, 451, 50)} <= set(words)
    assert {f"noise level A = {level} ×10⁻⁴" for level in ("0.8", "1", "1.2", "1.4")} <= set(words)
    assert any("measured" in text for text in words) == bool(measured)
    assert any("simulated" in text for text in words) == bool(measured)


def of_points(axes, table, columns):
    """{(pc1, pc2): (row, shape, fill, edge, size)} of the points of a panel."""
    rows = {(row["pc1"], row["pc2"]): row for _, row in table[columns].iterrows()}
    found = {}
    for collection in axes.findobj(PathCollection):
        count = len(collection.get_offsets())
        faces, edges = (
            [None] * count if not len(given) else [to_hex(color) for color in np.resize(given, (count, 4))]
            for given in (collection.get_facecolors(), collection.get_edgecolors())
        )
        for place, path, *look in zip(
            collection.get_offsets(), collection.get_paths(), faces, edges, collection.get_sizes(), strict=True
        ):
            found[tuple(place)] = (rows[tuple(place)], path.vertices.tobytes(), *look)
    return list(found.values())


def test_tissue_gives_the_color_and_protocol_the_shape(make_pca):
    table = make_pca(measured=3)
    columns = ["pc1", "pc2", "tissue_class", "source", "protocol", "noise_level"]
    drawn = of_points(pca.draw(table).axes[0], table, columns)
    colors, shapes = {}, {}
    for row, shape, face, edge, _ in drawn:
        simulated = row["source"] == "simulated"
        assert (face is not None) == simulated  # measured points are hollow
        colors.setdefault(row["tissue_class"], set()).add(face if simulated else edge)
        shapes.setdefault(row["protocol"] if simulated else "measured", set()).add(shape)
    assert all(len(found) == 1 for found in [*colors.values(), *shapes.values()])
    assert len(set.union(*colors.values())) == 4 and len(set.union(*shapes.values())) == 7


def test_noise_gives_size_and_fill(make_pca):
    table = make_pca(("a",), 0)
    table = table[table["protocol"] == "sirt_150"]
    figure = pca.draw(table)
    assert len(figure.axes) == 1  # all points are of one protocol and simulated
    found = {}
    for row, _, face, _, size in of_points(figure.axes[0], table, ["pc1", "pc2", "noise_level"]):
        found.setdefault(row["noise_level"], set()).add((size, face))
    assert all(len(look) == 1 for look in found.values())
    sizes, faces = zip(*(found[level].copy().pop() for level in sorted(found)), strict=True)
    brightness = [sum(matplotlib.colors.to_rgb(face)) for face in faces]
    assert list(sizes) == sorted(sizes) and len(set(sizes)) == 4
    assert brightness == sorted(brightness) and len(set(brightness)) == 4
    one = pca.draw(table[table["noise_level"] == 1e-4])
    assert len(one.axes) == 1 and "noise level A = 1 ×10⁻⁴" in texts(one)


def test_measured_rows_have_the_shape_of_their_condition(make_pca):
    table = make_pca(("a", "b"), 4)
    table.loc[table["source"] == "measured", "condition"] = ["A1", "B1"] * 4
    figure = pca.draw(table)
    shapes = {}
    for row, shape, face, *_ in of_points(figure.axes[0], table, ["pc1", "pc2", "source", "protocol", "condition"]):
        assert (face is None) == (row["source"] == "measured")
        shapes.setdefault(row["condition"] if row["source"] == "measured" else row["protocol"], set()).add(shape)
    assert all(len(found) == 1 for found in shapes.values()) and len(set.union(*shapes.values())) == 9
    assert {"A1", "B1"} <= set(texts(figure)) and "measured" not in texts(figure)


def test_thousands_of_projections_are_printed_in_full(make_pca):
    table = make_pca(("a",), 0)
    words = texts(pca.draw(table.assign(projections=10 * table["projections"])))
    assert {"SIRT 150: 1500 projections", "SIRT 450: 4500 projections"} <= set(words)


def test_many_measured_rows_lie_below_with_means_on_top(make_pca):
    table = make_pca(("a", "b"), 80)
    axes = pca.draw(table).axes[0]
    measured = table[table["source"] == "measured"]
    means = {tuple(mean) for mean in measured.groupby("roi")[["pc1", "pc2"]].mean().to_numpy()}
    order = {collection.get_zorder(): [] for collection in axes.findobj(PathCollection)}
    for collection in axes.findobj(PathCollection):
        order[collection.get_zorder()].append(np.asarray(collection.get_offsets()))
    beneath, _, top = (np.concatenate(order[key]) for key in sorted(order))
    assert len(beneath) == len(measured)
    assert np.array(sorted(map(tuple, top))) == pytest.approx(np.array(sorted(means)))


def test_bad_pca_tables_are_rejected(make_pca):
    table = make_pca()
    with pytest.raises(InputError, match="no rows"):
        pca.draw(table.iloc[:0])
    with pytest.raises(InputError, match="simulated rows: has no rows"):
        pca.draw(table[table["source"] == "measured"])
    with pytest.raises(InputError, match="explained variances differ"):
        pca.draw(table.assign(explained_pc1_percent=np.arange(len(table))))
    with pytest.raises(InputError, match="source guessed"):
        pca.draw(table.assign(source="guessed"))
    with pytest.raises(InputError, match="pc1 is not a finite number"):
        pca.draw(table.assign(pc1=np.inf))
