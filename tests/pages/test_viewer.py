"""Viewer: it contains the given voxels and displays them correctly."""

import base64
import gzip
import re

import numpy as np
import pytest
from browser import opened, outside_resources

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.io.volumes import Volume
from virtual_phantom.report import viewer

GRID = Grid((6, 20, 30), (2.0, 3.0, 1.5), (0, 0, 5))
SUBTITLE = "Noise level <loud>."


def volume(seed):
    return Volume(np.random.default_rng(seed).normal(50, 90, GRID.shape).astype(np.float32), GRID)


def arguments():
    masks = {name: np.zeros(GRID.shape, bool) for name in ("cyst_1", "liver & more")}
    masks["cyst_1"][2:5, 4:9, 20:26] = True
    masks["liver & more"][1:3, 12:15, 3:9] = True
    phantom = volume(0)
    phantom = Volume(np.where(np.arange(30) > 2, phantom.array, -1000), GRID)  # air on one side only
    reconstructions = {
        "fbp": viewer.Reconstruction("FBP, 150 projections", volume(1), volume(2), 3),
        "sirt": viewer.Reconstruction("SIRT, 150 projections", volume(3), volume(4), 3),
    }
    return phantom, masks, reconstructions


@pytest.fixture(scope="module")
def page():
    return viewer.viewer_page(*arguments(), SUBTITLE)


def stored(page, name, dtype="<i2"):
    text = re.search(rf'id="data_{name}">([^<]*)<', page)[1]
    return np.frombuffer(gzip.decompress(base64.b64decode(text)), dtype)


def test_page_contains_the_displayed_voxels(page):
    phantom, masks, reconstructions = arguments()
    inputs = {"input": phantom}
    for key, one in reconstructions.items():
        inputs |= {f"{key}_one": one.single, f"{key}_mean": one.mean}
    for name, volume in inputs.items():
        # The first voxel is anterior and on the patient's right: both at the high ends of the axes.
        expected = np.rint(volume.array)[:, ::-1, ::-1]
        np.testing.assert_array_equal(stored(page, name).reshape(GRID.shape), expected)
    labels = stored(page, "rois", np.uint8).reshape(GRID.shape)[:, ::-1, ::-1]
    for number, mask in enumerate(masks.values(), start=1):
        np.testing.assert_array_equal(labels == number, mask)


def test_page_is_one_file_and_escapes_names(page):
    assert outside_resources(page) == []
    assert "<loud>" not in page and "&lt;loud&gt;" in page
    assert page == viewer.viewer_page(*arguments(), SUBTITLE)


def test_large_studies_are_subsampled_to_the_limit():
    assert viewer.thinning((48, 128, 128), 5) == (1, 1, 1)
    for shape in ((96, 512, 512), (300, 512, 512), (1000, 128, 128)):
        steps = viewer.thinning(shape, 5)
        voxel_count = np.zeros(shape, np.int8)[:: steps[0], :: steps[1], :: steps[2]].size
        assert 2 * 5 * voxel_count <= viewer.MOST_BYTES
    phantom, masks, reconstructions = arguments()
    array = viewer.displayed(phantom.array, (2, 1, 3))
    np.testing.assert_array_equal(array, phantom.array[::2, ::-1, ::-3])


@pytest.mark.parametrize(
    "array, grid, message",
    [
        (np.zeros(GRID.shape), Grid(GRID.shape, GRID.spacing), "is on another grid than the phantom"),
        (np.full(GRID.shape, np.nan), GRID, "fbp_one: has values that are not finite"),
    ],
)
def test_unsuitable_input_is_rejected_in_one_line(array, grid, message):
    phantom, masks, reconstructions = arguments()
    bad = viewer.Reconstruction("FBP", Volume(array, grid), volume(2), 3)
    with pytest.raises(InputError, match=message):
        viewer.viewer_page(phantom, masks, reconstructions | {"fbp": bad}, SUBTITLE)


LOOK = """
const set = (id, value) => { element(id).value = value; element(id).dispatchEvent(new Event("input")); };
set("outlines", "");
const grey = (n, line, column) => [...panels[n].canvas.getContext("2d").getImageData(
  column * zoom + zoom / 2, line * zoom + zoom / 2, 1, 1).data];
const first = element("slice").value;
set("slice", 4); set("level", 100); set("width", 500); set("limit", 200);
const found = {first, preset: element("preset").value, one: [grey(0, 7, 11), grey(1, 7, 11), grey(2, 7, 11)]};
set("part", "mean"); found.mean = [grey(1, 7, 11), grey(2, 7, 11)];
set("outlines", "1"); found.edge = panels[0].canvas.getContext("2d").getImageData(9 * zoom, 13 * zoom, 1, 1).data[3];
set("preset", "-600,1500"); found.window = [element("level").value, element("width").value];
dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowUp"})); found.slice = element("slice_text").textContent;
found.problem = element("problem").hidden; found.panels = panels.length;
found.wider = document.documentElement.scrollWidth > innerWidth;
return found;
"""


@pytest.mark.parametrize("width", [1280, 390])
def test_browser_shows_slices_windows_and_differences(page, tmp_path, width):
    found = opened(page, tmp_path, LOOK, width)
    phantom, _, reconstructions = arguments()
    # Line 7 and column 11 of the display are row 12 and column 18 of the arrays.
    value, one, mean = (
        float(np.rint(volume.array[4, 12, 18]))
        for volume in (phantom, reconstructions["fbp"].single, reconstructions["fbp"].mean)
    )

    def gray(hu):
        return [pytest.approx(np.clip(255 * ((hu - 100) / 500 + 0.5), 0, 255), abs=1)] * 3 + [255]

    def colored(difference):
        share = np.clip(difference / 200, -1, 1)
        end = (33, 102, 172) if share < 0 else (178, 24, 43)
        return [pytest.approx(247 + (c - 247) * abs(share), abs=1) for c in end] + [255]

    assert found["first"] == "2" and found["preset"] == ""
    assert found["one"] == [gray(value), gray(one), colored(one - value)]
    assert found["mean"] == [gray(mean), colored(mean - value)]
    assert found["window"] == ["-600", "1500"] and found["slice"] == "6 of 6"
    assert found["problem"] is True and found["panels"] == 5 and found["wider"] is False
