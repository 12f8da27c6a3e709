"""Comparison figures: every cell is drawn at its position in its color."""

import matplotlib
import numpy as np
import pandas
import pytest
from figure_checks import assert_text_fits, texts
from matplotlib.collections import PathCollection, QuadMesh

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.figures import comparison as figures
from virtual_phantom.figures import style
from virtual_phantom.statistics import comparison, comparison_summary
from virtual_phantom.statistics.measured import TISSUE_CLASSES


@pytest.fixture(scope="module")
def table():
    """Recorded repeats of SD 1; simulated ones with shifts of about -60 to 60 and SDs of 1/16 to 16."""
    rng = np.random.default_rng(0)
    parts = []
    for simulated in (True, False):
        rows = []
        for roi, name in TISSUE_CLASSES.items():
            centre = rng.normal(size=86) * 10 ** rng.uniform(-1, 1.3, 86) * simulated
            spread = 2.0 ** rng.uniform(-4, 4, 86) if simulated else np.ones(86)
            values = centre + spread * rng.normal(size=(8, 86))
            rows.append(pandas.DataFrame(values, columns=list(FEATURES)).assign(roi=roi, tissue_class=name))
        parts.append(pandas.concat(rows))
    parts[0][FEATURES[0]] = parts[1][FEATURES[0]] = 3.0  # one constant feature
    parts[1][FEATURES[1]] = 3.0  # one feature in the recording only
    return comparison.compare(*parts, FEATURES)


def meshes(axes):
    return [child for child in axes.get_children() if isinstance(child, QuadMesh)]


def cells(axes):
    """Colors of all cells, top to bottom, [row, column]."""
    found = []
    for mesh in meshes(axes):
        mesh.update_scalarmappable()
        rows, columns = mesh.get_array().shape[:2]
        found.append(mesh.get_facecolors().reshape(rows, columns, 4))
    return np.concatenate(found)


def test_every_cell_has_the_color_of_its_step(table):
    shuffled = table.sample(frac=1, random_state=1)
    rois = list(dict.fromkeys(shuffled["roi"]))
    figure = figures.draw(shuffled, comparison_summary.ranks(table))
    colours = cells(figure.axes[0])
    assert colours.shape == (86, 6, 4)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    family = [style.family_label(f.split("_")[1]) for f in FEATURES]
    wide = table.pivot(index="feature", columns="roi", values="shift_sd")[rois]
    # rows are grouped by family, in any order within a family
    mesh_sizes = [mesh.get_array().shape[0] for mesh in meshes(figure.axes[0])]
    assert sorted(mesh_sizes) == sorted(pandas.Series(family).value_counts())
    by_family = dict(zip((label for label in texts(figure) if label in set(family)), mesh_sizes, strict=False))
    assert by_family["First order"] == 18 and list(by_family)[0] == "First order"
    order = [name for name, size in by_family.items() for _ in range(size)]
    known = {(style.family_label(f.split("_")[1]), f.split("_")[2]): f for f in FEATURES}
    white = matplotlib.colors.to_rgba(figures.NEUTRAL)
    distinct = {}
    for row, (name, label) in enumerate(zip(order, labels, strict=True)):
        for column, shift in enumerate(wide.loc[known[name, label]]):
            assert (tuple(colours[row, column]) == white) == (abs(shift) <= 1)
            step = np.sign(shift) * np.searchsorted(figures.SHIFT_STEPS, abs(shift))
            distinct.setdefault(step, set()).add(tuple(colours[row, column]))
    assert all(len(of_step) == 1 for of_step in distinct.values())
    assert len(set.union(*distinct.values())) == len(distinct) == 9


def test_constant_cells_and_marks(table):
    figure = figures.draw(table, comparison_summary.summary(table), "title")
    ratio = cells(figure.axes[1])
    grey = np.all(np.isclose(ratio, matplotlib.colors.to_rgba(figures.MISSING)), axis=-1)
    assert grey.sum() == 6 and grey[0].all()  # both constant
    darkest = matplotlib.colormaps[figures.RATIO_COLORS](1.0)
    assert np.allclose(ratio[1], darkest)  # infinite
    for axes, q, equivalent in (
        (figure.axes[0], "q_mean", "mean_equivalent"),
        (figure.axes[1], "q_sd", "sd_equivalent"),
    ):
        black, white, rings = (len(c.get_offsets()) for c in axes.collections if isinstance(c, PathCollection))
        assert black + white == (table[q] < 0.05).sum() and rings == table[equivalent].sum()
        assert white > 0 or q == "q_sd"
    tau = comparison_summary.ranks(table)["kendall_tau"]
    words = texts(figure)
    assert words.count("–") == tau.isna().sum() > 0
    assert {"title", "cyst 1", "−30", "30", "1/8", "1/2", "8", "equivalent"} <= set(words)
    assert {"shift of the mean (repeat SDs of the recording)", "SD over repeats, simulated / recorded"} <= set(words)


def test_margin_moves_the_color_steps(table):
    words = texts(figures.draw(table.assign(margin_sd=0.5, sd_factor=1.5), comparison_summary.ranks(table)))
    assert {"−0.5", "0.5", "15", "1.5", "1/1.5"} <= set(words)


def test_text_fits_on_the_pages(table):
    summary = comparison_summary.summary(table)
    page = figures.draw(table, summary)
    one = table[(table["roi"] == "cyst_1") & table["feature"].isin(FEATURES[:2])]
    little = comparison_summary.summary(one)
    for figure in (page, figures.draw(one, little)):
        assert_text_fits(figure)
    assert page.get_figheight() * 25.4 < 260  # A4 has 297 mm


def test_bad_tables_are_rejected(table):
    ranking = comparison_summary.ranks(table)
    for wrong, ranks, message in (
        (table.iloc[:0], ranking, "has no rows"),
        (table.iloc[1:], ranking, "needs exactly one row for every ROI and feature"),
        (pandas.concat([table, table.iloc[:1]]), ranking, "exactly one row for every"),
        (table.drop(columns="q_sd"), ranking, "lacks the column q_sd"),
        (table, ranking.iloc[1:], f"ranks of the comparison: {FEATURES[0]} is missing"),
    ):
        with pytest.raises(InputError, match=message):
            figures.draw(wrong, ranks)


def test_table_without_roi_order_has_no_order_column(table):
    few = table[table["roi"].isin(list(dict.fromkeys(table["roi"]))[:2])]
    words = texts(figures.draw(few, comparison_summary.summary(few)))
    assert not [text for text in words if "τ" in text] and "equivalent" in words
    assert {"order,\nτ", "τ ≥ 0.7: ROIs in order"} <= set(texts(figures.draw(table, comparison_summary.summary(table))))


def test_features_that_cannot_be_compared_are_marked(table):
    summary = comparison_summary.summary(table).assign(other_settings="", other_sizes="")
    summary.loc[summary["feature"] == FEATURES[2], "other_settings"] = "binWidth is 10, the study's 25"
    size = "512 voxels of 1 mm³, the study's 216 voxels of 1 mm³"
    summary.loc[summary["feature"].isin(FEATURES[2:4]), "other_sizes"] = size
    figure = figures.draw(table, summary, "title")
    assert_text_fits(figure)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    names = [feature.rpartition("_")[2] for feature in FEATURES[2:4]]
    assert [label for label in labels if label.split()[-1] in "*†"] == [f"{names[0]} * †", f"{names[1]} †"]
    head = figure.get_suptitle().splitlines()
    assert head[1:] == [
        "* recording: binWidth is 10, the study's 25",
        f"† grows with the ROI; recording: {size}",
    ]


@pytest.mark.parametrize("count", [1, 2, 6])
def test_labels_do_not_overlap_with_few_rois(table, count):
    few = table[table["roi"].isin(list(dict.fromkeys(table["roi"]))[:count])]
    figure = figures.draw(few, comparison_summary.ranks(table))
    assert_text_fits(figure)
    figure.draw_without_rendering()
    scales = [axes.xaxis.label.get_window_extent() for axes in figure.axes if axes.xaxis.label.get_text()]
    assert len(scales) >= 2
    for place, one in enumerate(scales):
        assert not any(one.overlaps(other) for other in scales[:place])
