"""Confusion matrix: every case is counted once, in its cell, and legible; maps before and after a diagnosis."""

import numpy as np
from figure_checks import assert_text_fits, texts
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle

from virtual_phantom.figures import before_after, style
from virtual_phantom.figures.confusion import draw

NAMES = [f"effect_number_{number}" for number in range(20)]


def cell(row, column, strength, count, **outcomes):
    counts = {"right": 0, "alternative": 0, "wrong": 0} | outcomes
    return {"row": row, "column": column, "strength": strength, "count": count, "outcomes": counts}


def matrix(cells):
    return {
        "rows": [*NAMES, "nothing", "rotation_blur (not in library)"],
        "columns": [*NAMES, "nothing", "no effect fits"],
        "cells": cells,
    }


def drawn(figure):
    """{(row label, column label): (text, color of the fill)} of the cells, and both lists of labels."""
    (axes,) = figure.axes
    rows, columns = (
        [text.get_text() for text in labels] for labels in (axes.get_yticklabels(), axes.get_xticklabels())
    )
    boxes = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    fills = {(round(box.get_center()[0]), round(box.get_center()[1])): box.get_facecolor() for box in boxes}
    cells = {}
    for text in axes.texts:
        x, y = map(round, text.get_position())
        cells[rows[y], columns[x]] = text.get_text(), to_hex(fills.pop((x, y))).upper()
    assert not fills
    return cells, rows, columns


def test_cells_show_shares_in_sorted_rows():
    cells = [
        cell(NAMES[3], NAMES[3], "strong", 6, right=6),
        cell(NAMES[3], NAMES[3], "weak", 2, right=2),
        cell(NAMES[3], NAMES[5], "weak", 4, wrong=1, alternative=3),
        cell(NAMES[0], NAMES[1], "strong", 2, alternative=2),
        cell(NAMES[7], NAMES[7], "medium", 3, right=3),
        cell("nothing", "nothing", None, 11, right=11),
        cell("nothing", NAMES[5], None, 1, wrong=1),
        cell("rotation_blur (not in library)", "no effect fits", None, 1, right=1),
    ]
    figure = draw(matrix(cells))
    assert_text_fits(figure)
    found, rows, columns = drawn(figure)
    first, third, seventh = (f"effect number {number}" for number in (0, 3, 7))
    lacking = "rotation blur (not in library) (n = 1)"
    assert rows == [f"{first} (n = 2)", f"{third} (n = 12)", f"{seventh} (n = 3)", "nothing (n = 12)", lacking]
    assert columns == ["the hidden effect", "effect number 5", "effect number 1", "nothing", "no effect fits"]
    wrong = "#F6C9A8"
    assert found == {
        (rows[0], "effect number 1"): ("100", "#FFFFFF"),
        (rows[1], "the hidden effect"): ("67", style.BLUE),
        (rows[1], "effect number 5"): ("33", wrong),  # one wrong answer among alternatives counts
        (rows[2], "the hidden effect"): ("100", style.BLUE),
        (rows[3], "nothing"): ("92", style.BLUE),
        (rows[3], "effect number 5"): ("8", wrong),
        (rows[4], "no effect fits"): ("100", style.BLUE),
    }


def test_example_names_the_hidden_effect():
    figure = before_after.draw(np.zeros((30, 20)), np.ones((30, 20)), "images", "heel (weak)", "bowtie and heel")
    assert_text_fits(figure)
    found = texts(figure)
    assert "hidden: heel (weak); found: bowtie and heel" in found and {"row", "column"} <= set(found)
    assert len({image.get_clim() for axes in figure.axes for image in axes.images}) == 1
