"""Figures of images: orientation, content and labels."""

import numpy as np
import pytest
from figure_checks import texts
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.contour import ContourSet
from matplotlib.text import Text

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.names import label
from virtual_phantom.figures import axial, rois, scans
from virtual_phantom.io.volumes import Volume


def place_on_page(figure, axes, chosen):
    """Center of the pixels for which chosen(rgb) holds, as fractions of the axes from their lower left."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3].astype(int)
    box = axes.get_window_extent()
    inside = pixels[round(box.y0) : round(box.y1), round(box.x0) : round(box.x1)]
    rows, columns = np.nonzero(chosen(inside))
    return columns.mean() / inside.shape[1], rows.mean() / inside.shape[0]


@pytest.mark.parametrize(
    ("x_mm", "y_mm", "left", "top"),
    [(60, 0, True, None), (-60, 0, False, None), (0, 40, None, True), (0, -40, None, False)],
)
def test_radiological_orientation(x_mm, y_mm, left, top):
    """+x is the patient's right, on the left of the page; +y is anterior, at its top."""
    grid = Grid((1, 60, 80), (4.0, 4.0, 4.0))
    _, y, x = grid.axes_mm()
    body = (x[None, :] / 140) ** 2 + (y[:, None] / 100) ** 2 < 1
    spot = (np.abs(x[None, :] - x_mm) < 20) & (np.abs(y[:, None] - y_mm) < 20)
    image = np.where(spot, 1000, np.where(body, 0, -1000)).astype(np.float32)[None]
    flat = np.zeros_like(image)  # a second image, so that the figure has something to compare
    figure = scans.draw(Volume(image, grid), {"flat": Volume(flat, grid)}, 0)
    across, up = place_on_page(figure, figure.axes[0], lambda rgb: rgb.min(axis=-1) > 240)
    assert left is None or (across < 0.45) == left and abs(across - 0.5) > 0.1
    assert top is None or (up > 0.55) == top and abs(up - 0.5) > 0.1


def test_pixels_are_to_scale(make_phantom):
    """Voxels of 2 x 4 mm: a round ROI is drawn round."""
    phantom, masks = make_phantom(["aorta"], shape=(12, 120, 80), spacing=(5.0, 2.0, 4.0))
    figure = rois.draw(phantom, masks, {"aorta": "vessel"})
    FigureCanvasAgg(figure).draw()
    outline = figure.axes[0].findobj(ContourSet)[0].get_paths()[0].vertices
    extent = np.ptp(figure.axes[0].transData.transform(outline), axis=0)
    assert extent[0] / extent[1] == pytest.approx(1, abs=0.25)  # within a voxel: 4 of 22 mm


@pytest.mark.parametrize(
    "names",
    [
        ["aorta"],
        ["normal_1", "normal_2", "cyst_1", "cyst_2", "hemangioma", "metastasis"],
        [f"my_roi_${index}" for index in range(12)],
    ],
)
def test_every_roi_is_outlined_and_named(make_phantom, names):
    phantom, masks = make_phantom(names)
    figure = rois.draw(phantom, masks, {name: name[:4] for name in names})
    words = texts(figure)
    for name in names:
        assert label(name) in words
    outlines = sum(len(axes.findobj(ContourSet)) for axes in figure.axes)
    assert outlines >= len(names)
    assert "CT number (HU)" in words and "R" in words and "L" in words
    assert any(text.endswith(" mm") and text.split()[0].isdigit() for text in words), "scale bar"


def test_names_do_not_overlap(make_phantom):
    names = [f"roi_{index}" for index in range(12)]
    phantom, masks = make_phantom(names)
    masks = {name: masks["roi_0"] | masks["roi_1"] for name in names}  # all at one height
    figure = rois.draw(phantom, masks, dict.fromkeys(names, "tissue"))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    labels = [text for text in figure.axes[0].texts if text.get_text().startswith("ROI ")]
    boxes = [Text.get_window_extent(label, canvas.get_renderer()) for label in labels]
    assert len(boxes) == 12
    for index, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[index + 1 :])


def test_outline_follows_the_mask(make_phantom):
    phantom, masks = make_phantom(["cyst"])
    figure = rois.draw(phantom, masks, {"cyst": "cyst"})
    vertices = figure.axes[0].findobj(ContourSet)[0].get_paths()[0].vertices
    affine = phantom.grid.affine
    z, y, x = (index.mean() for index in np.nonzero(masks["cyst"]))
    assert vertices.mean(axis=0) == pytest.approx((affine @ [x, y, z, 1])[:2], abs=1.0)


def test_slice_positions_match_the_file(make_phantom):
    phantom, masks = make_phantom(["cyst"])
    z = axial.choose_slices(masks)[0]
    assert axial.slice_z_mm(phantom.grid, z) == pytest.approx((phantom.grid.affine @ [0, 0, z, 1])[2])


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 10)), min_size=1, max_size=12))
def test_chosen_slices_show_every_roi(spans):
    masks = {}
    for index, (first, length) in enumerate(spans):
        masks[str(index)] = np.zeros((20, 2, 2), bool)
        masks[str(index)][first : first + length] = True
    chosen = axial.choose_slices(masks)
    assert len(chosen) == len(set(chosen)) <= len(masks)
    assert all(any(mask[z].any() for z in chosen) for mask in masks.values())


def test_fewest_slices():
    """Three ROIs that share slice 4 need one slice; a separate one needs another."""
    masks = {name: np.zeros((10, 3, 3), np.uint8) for name in "abcd"}
    masks["a"][2:5], masks["b"][4:7], masks["c"][4], masks["d"][9] = 1, 1, 1, 1
    assert axial.choose_slices(masks) == [4, 9]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=15))
def test_spread_keeps_order_and_distance(heights):
    gap = 0.06
    placed = rois.spread(sorted(heights), gap)
    assert np.all(np.diff(placed) >= min(gap, 1 / len(placed)) - 1e-9)
    assert min(placed) >= -1e-9 and max(placed) <= 1 + 1e-9


def test_body_is_the_largest_region_with_filled_holes():
    image = np.full((20, 20), -1000.0)
    image[3:17, 3:17] = 40
    image[8:11, 8:11] = -900  # gas
    image[0, 0] = 40  # a speck of the table
    body = axial.body_mask(image)
    assert body.sum() == 14 * 14 and not body[0, 0] and body[9, 9]


def test_rms_is_taken_in_the_body(make_phantom, rng):
    """Differences of 7 HU in the body and 500 HU in the air around it: 7.0 HU."""
    phantom, _ = make_phantom(["cyst"])
    air = phantom.array < -500
    wrong = Volume(np.where(air, phantom.array + 500, phantom.array - 7).astype(np.float32), phantom.grid)
    words = texts(scans.draw(phantom, {"FBP": wrong, "SIRT": phantom}, 12))
    assert "FBP − input\nRMS 7.0 HU in the body" in words
    assert "SIRT − input\nRMS 0.0 HU in the body" in words
    assert "CT number (HU)" in words and "difference from the input (HU)" in words


def test_scans_share_window_and_slice(make_phantom, rng):
    phantom, _ = make_phantom(["cyst"])
    noisy = Volume(phantom.array + rng.normal(0, 20, phantom.array.shape).astype(np.float32), phantom.grid)
    figure = scans.draw(phantom, {"FBP": noisy, "SIRT": phantom}, 5)
    pictures = [axes.images[0] for axes in figure.axes if axes.images]
    assert [picture.get_clim() for picture in pictures[:3]] == [(-160, 240)] * 3
    assert np.array_equal(pictures[0].get_array(), phantom.array[5])
    assert np.array_equal(pictures[1].get_array(), noisy.array[5])
    assert pictures[3].get_clim() == pictures[4].get_clim()
    assert pictures[3].get_clim()[0] == -pictures[3].get_clim()[1]
    assert "input" in figure.axes[4].get_title()


@pytest.mark.parametrize(
    ("value", "expected"), [(0, 1), (0.3, 0.5), (1, 1), (47, 50), (51, 100), (200, 200), (980, 1000)]
)
def test_round_up(value, expected):
    assert scans.round_up(value) == pytest.approx(expected)


def test_bad_input(make_phantom):
    phantom, masks = make_phantom(["cyst"])
    with pytest.raises(InputError, match="none to draw"):
        rois.draw(phantom, {}, {})
    with pytest.raises(InputError, match="cyst: its mask is empty"):
        rois.draw(phantom, {"cyst": np.zeros(phantom.grid.shape)}, {"cyst": "cyst"})
    with pytest.raises(InputError, match="cyst: mask of shape"):
        rois.draw(phantom, {"cyst": masks["cyst"][1:]}, {"cyst": "cyst"})
    with pytest.raises(InputError, match="no tissue class"):
        rois.draw(phantom, masks, {})
    with pytest.raises(InputError, match="at least one reconstruction"):
        scans.draw(phantom, {}, 0)
    other = Grid(phantom.grid.shape, (5.0, 4.0, 4.1))
    with pytest.raises(InputError, match="FBP: grid"):
        scans.draw(phantom, {"FBP": Volume(phantom.array, other)}, 0)
    broken = phantom.array.copy()
    broken[12, 5, 5] = np.nan
    with pytest.raises(InputError, match="not finite"):
        scans.draw(phantom, {"FBP": Volume(broken, phantom.grid)}, 12)
    with pytest.raises(InputError, match="check that the image is in HU"):
        scans.draw(Volume(phantom.array - 5000, phantom.grid), {"FBP": phantom}, 0)
