"""Confusion matrix: every case is counted once, in its cell, and legible."""

import numpy as np
from figure_checks import assert_text_fits, texts
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle

from virtual_phantom.figures import before_after, style
from virtual_phantom.figures.confusion import draw

NAMES = [f"effect_number_{number}" for number in range(20)]


def cell(row, column, strength, count, **outcomes):
    counts = {"right": 0, "stand-in": 0, "wrong": 0} | {key.replace("_", "-"): n for key, n in outcomes.items()}
    return {"row": row, "column": column, "strength": strength, "count": count, "outcomes": counts}


def matrix(cells):
    return {
        "rows": [*NAMES, "nothing", "rotation_blur (not in library)", "off_focal_radiation (not in library)"],
        "columns": [*NAMES, "nothing", "no effect fits"],
        "cells": cells,
    }


def faces(figure):
    """{(x, y) of the corner: color} of the rectangles over the grid."""
    (axes,) = figure.axes
    found = {}
    for patch in axes.patches:
        if isinstance(patch, Rectangle) and patch.get_zorder() == 2:
            found[round(patch.get_x(), 2), round(patch.get_y(), 2)] = to_hex(patch.get_facecolor()).upper()
    return found


def test_cells_are_at_their_positions():
    cells = [
        cell(NAMES[3], NAMES[3], "strong", 7, right=7),
        cell(NAMES[3], NAMES[5], "weak", 4, right=0, wrong=1, stand_in=3),
        cell(NAMES[0], NAMES[1], "strong", 2, stand_in=2),
        cell("nothing", "nothing", None, 11, right=11),
    ]
    figure = draw(matrix(cells))
    assert_text_fits(figure)
    assert {"7", "4", "2", "11", "effect number 19", "off focal radiation (not in library)"} <= set(texts(figure))
    drawn = faces(figure)
    assert len(drawn) == 4
    assert drawn[round(3 - 0.46 + 0.92 * 2 / 3, 2), 2.54] == style.BLUE
    assert drawn[0.54 + round(0.92 * 2 / 3, 2), -0.46] == "#FFFFFF"
    assert drawn[19.54, 19.54] == style.BLUE
    weak = np.array([int(drawn[4.54, 2.54][i : i + 2], 16) for i in (1, 3, 5)])
    full = np.array([int(style.VERMILLION[i : i + 2], 16) for i in (1, 3, 5)])
    assert (weak >= full).all() and weak.sum() > full.sum()  # lighter; one wrong answer among alternatives counts


def test_example_names_the_hidden_effect():
    figure = before_after.draw(np.zeros((30, 20)), np.ones((30, 20)), "images", "heel (weak)", "bowtie and heel")
    assert_text_fits(figure)
    found = texts(figure)
    assert "hidden: heel (weak), found: bowtie and heel" in found and {"row", "column"} <= set(found)
    assert len({image.get_clim() for axes in figure.axes for image in axes.images}) == 1
