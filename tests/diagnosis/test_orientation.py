"""Image orientation: every wrong order of voxels is named, and correct images pass."""

import numpy as np
import pytest
from scipy import ndimage
from simulated_scans import body

from virtual_phantom.base.geometry import Grid
from virtual_phantom.diagnosis.setup.finding import AS_STATED, DESCRIPTION, OBJECT
from virtual_phantom.diagnosis.setup.orientation import OTHERS, STATED, orientation

PHANTOM = Grid((40, 128, 128), (4.0, 2.0, 2.0))
IMAGES = Grid((24, 90, 90), (6.0, 2.8, 2.8))
INSERTS = [
    ((50, 10, 20), 22, 800.0),
    ((-40, -20, -25), 24, -80.0),
    ((10, 35, -5), 18, 90.0),
    ((-30, 35, 35), 15, 200.0),
]


@pytest.fixture(scope="module")
def phantom():
    return body(PHANTOM, (105, 80), 20.0, INSERTS).array


def recorded(seed, *, repeats=3, inserts=INSERTS, shift=(4.0, -3.0, 2.0), sigma=30.0, axes=(105, 80)):
    """Repeats on another grid: shifted, blurred, distorted as by beam hardening, with an offset and noise."""
    random = np.random.default_rng(np.random.SeedSequence(seed))
    clean = body(IMAGES, axes, 20.0, inserts).array
    clean = ndimage.shift(clean, np.divide(shift, IMAGES.spacing), order=1, mode="nearest")
    clean = ndimage.gaussian_filter(clean, (0, 0.6, 0.6))
    bent = 0.96 * (clean + 1000) - 2e-5 * (clean + 1000) ** 2 - 1000 + 15
    return bent + random.normal(0, sigma, (repeats, *bent.shape))


@pytest.mark.parametrize("one", OTHERS, ids=lambda one: one.name)
def test_every_wrong_order_of_voxels_is_named(phantom, one):
    # Images in a wrong order: the inverse order, which equals the order itself except for quarter turns.
    images = recorded(3)
    laid = np.stack([restored(one, image) for image in images])
    found = orientation(laid, phantom, PHANTOM, IMAGES)
    assert found.kind == DESCRIPTION and list(found.mistakes) == [one.name], (found.share_stated, found.share)
    assert found.mistakes[one.name].startswith("repeats: ")
    assert found.share < 0.1 < 0.5 < found.share_stated


def restored(one, image):
    index = np.arange(image.size).reshape(image.shape)
    back = np.empty(image.size, image.dtype)
    back[one.ordered(index).ravel()] = image.ravel()
    return back.reshape(image.shape)


@pytest.mark.parametrize("seed", range(5))
def test_correct_images_pass(phantom, seed):
    random = np.random.default_rng(np.random.SeedSequence(100 + seed))
    found = orientation(recorded(seed, shift=random.uniform(-4, 4, 3)), phantom, PHANTOM, IMAGES)
    assert found.kind == AS_STATED and not found.mistakes and not found.alike
    assert found.share == found.share_stated < 0.1


def test_orders_that_the_object_cannot_show_are_listed():
    """Inserts on the axis of x that are constant along z: slices and y may be reversed."""
    inserts = [((50, 0, None), 22, 800.0), ((-40, 0, None), 24, -80.0)]
    plain = body(PHANTOM, (105, 80), 20.0, inserts).array
    found = orientation(recorded(5, inserts=inserts), plain, PHANTOM, IMAGES)
    assert found.kind == AS_STATED
    assert {"slices in the other order", "mirrored front to back"} <= set(found.alike)
    assert "mirrored left to right" not in found.alike


def test_homogeneous_object_shows_no_order():
    plain = body(PHANTOM, (105, 80), 20.0, []).array
    found = orientation(recorded(6, inserts=[])[:1], plain, PHANTOM, IMAGES)
    assert found.kind == AS_STATED and not found.mistakes


def test_other_organs_are_not_reported_as_wrong_order(phantom):
    """Inserts at other positions fit in no order. Physics and objects are checked later."""
    others = [((-10, 10, 0), 22, 800.0), ((30, -45, 10), 18, -80.0)]
    found = orientation(recorded(7, inserts=others), phantom, PHANTOM, IMAGES)
    assert found.kind == AS_STATED and found.share > 0.5


def test_other_body_is_reported(phantom):
    assert orientation(recorded(8, axes=(35, 30), inserts=[]), phantom, PHANTOM, IMAGES).kind == OBJECT


def test_body_of_other_width_with_other_organs_is_reported_as_another_object(phantom):
    """The bodies overlap by over 0.6, but the images and the phantom correlate by less than 0.9."""
    others = [((-10, 10, 0), 22, 800.0), ((30, -25, 10), 18, -80.0)]
    found = orientation(recorded(9, axes=(70, 60), inserts=others), phantom, PHANTOM, IMAGES)
    assert found.kind == OBJECT and found.share > 0.19


@pytest.mark.parametrize("shift, where", [((0.0, 0.0, 40.0), "40, 0, 0"), ((0.0, -45.0, 20.0), "20, -45, 0")])
def test_images_far_from_the_isocenter_are_reported_with_their_shift(shift, where):
    small = [((20, 5, 10), 14, 800.0), ((-15, -10, -15), 12, -80.0)]
    of = body(PHANTOM, (50, 40), 20.0, small).array
    found = orientation(recorded(10, shift=shift, axes=(50, 40), inserts=small), of, PHANTOM, IMAGES)
    assert (found.kind, list(found.mistakes)) == (DESCRIPTION, ["location"])
    off = [float(number) for number in found.mistakes["location"].split("(it is ")[1].split(" mm")[0].split(", ")]
    assert off == pytest.approx([float(part) for part in where.split(", ")], abs=2.0)


def test_restored_order_is_the_inverse():
    image = np.random.default_rng(1).normal(size=(3, 4, 4))
    for one in (STATED, *OTHERS):
        np.testing.assert_array_equal(one.ordered(restored(one, image)), image)
