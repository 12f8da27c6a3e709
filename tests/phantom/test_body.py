"""Body segmentation: complete whatever the body contains, without arms and table where these are separate."""

import numpy as np
import pytest

from virtual_phantom.base.geometry import Grid
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom.body import edges_mm, find_body

GRID = Grid((10, 100, 130), (8.0, 4.0, 4.0), (7.0, -30.0, 500.0))
Z, Y, X = np.meshgrid(*GRID.axes_mm(), indexing="ij")
CHEST = (-165, 165, -110, 110)  # x from, to, y from, to: mm from the grid's middle


def ellipse(a, b, x=0.0, y=0.0):
    return ((X - x) / a) ** 2 + ((Y - y) / b) ** 2 < 1


def air():
    return np.full(GRID.shape, -1000.0)


def chest():
    """Lungs that reach to 10 mm below the skin, a heart, and a nodule in a lung."""
    hu = np.where(ellipse(165, 110), 0.0, -1000.0)
    inside = ellipse(155, 100)
    hu[(ellipse(75, 90, 80) | ellipse(75, 90, -80)) & inside] = -850
    hu[ellipse(40, 40, 10, 20)] = 45
    hu[(X + 85) ** 2 + Y**2 + Z**2 < 15**2] = 30
    return hu


def with_object_in_air(hu, mask, value=50):
    """The image with an additional object in the air."""
    return np.where(mask & (hu < -900), value, hu)


def plate(top, width=210, hollow=False):
    shape = (abs(X) < width) & (top - (48 if hollow else 8) < Y) & (top > Y)
    return shape & ~((abs(X) < width - 8) & (top - 40 < Y) & (top - 8 > Y)) if hollow else shape


def head():
    """Skull, sinuses, nose and ear."""
    hu = np.where(ellipse(75, 95) | ellipse(8, 16, 0, 97) | ellipse(6, 16, 77), 0.0, -1000.0)
    hu[ellipse(70, 90)] = 1200
    hu[ellipse(62, 82)] = 35
    hu[ellipse(14, 12, -20, 65) | ellipse(14, 12, 20, 65)] = -1000
    return hu


def shell(gap):
    hu = np.where((np.hypot(X, Y) < 100) & (np.hypot(X, Y) > 88), 120.0, -1000.0)
    hu[np.hypot(X, Y) < 88 - gap] = 0
    return hu


CASES = {
    "lungs": (chest, CHEST),
    "a thin wall": (lambda: np.where(ellipse(152, 97) & ~ellipse(50, 60), -850, chest()), CHEST),
    "a wall thinner than pixels": (lambda: np.where(ellipse(162, 107) & ~ellipse(50, 60), -850, chest()), CHEST),
    "a trachea open to the front": (lambda: np.where((abs(X) < 8) & (Y > 0) & (Z > 20), -1000, chest()), CHEST),
    "a lung open to the top": (
        lambda: np.where(ellipse(75, 90, 80) & ellipse(160, 105) & (Z > 20), -900, chest()),
        CHEST,
    ),
    "noise of 150 HU": (lambda: chest() + np.random.default_rng(0).normal(0, 150, X.shape), CHEST),
    "a field of view that is too small": (
        lambda: np.where(np.hypot(X, Y) > 140, -1000, chest()),
        (-140, 140, -110, 110),
    ),
    "a lung at the border of the CT": (lambda: np.where(X > 140, -1000, chest()), (-165, 140, -110, 110)),
    "a skull": (head, (-75, 83, -95, 113)),
    "a skull, arms up": (
        lambda: with_object_in_air(head(), ellipse(36, 36, 130) | ellipse(36, 36, -130)),
        (-75, 83, -95, 113),
    ),
    "two legs": (lambda: with_object_in_air(air(), ellipse(70, 75, 85) | ellipse(70, 75, -85)), (-155, 155, -75, 75)),
    "two legs, one larger": (
        lambda: with_object_in_air(air(), ellipse(70, 75, 85) | ellipse(55, 60, -85)),
        (-140, 155, -75, 75),
    ),
    "arms beside": (lambda: with_object_in_air(chest(), ellipse(36, 36, 215, -20) | ellipse(36, 36, -215, -20)), CHEST),
    "arms that touch": (
        lambda: with_object_in_air(chest(), ellipse(36, 36, 201, -20) | ellipse(36, 36, -201, -20)),
        CHEST,
    ),
    "a table": (lambda: with_object_in_air(chest(), plate(-120)), CHEST),
    "a hollow table": (lambda: with_object_in_air(chest(), plate(-120, hollow=True)), CHEST),
    "a table that touches": (lambda: with_object_in_air(chest(), plate(-108)), CHEST),
    "a table in front, prone": (lambda: with_object_in_air(chest(), plate(-120)[:, ::-1]), CHEST),
    "a sheet and a cable": (
        lambda: with_object_in_air(chest(), (abs(Y - 124) < 4) | ellipse(5, 5, 210, 60), -300),
        CHEST,
    ),
    "breasts": (
        lambda: with_object_in_air(chest(), ellipse(45, 60, 70, 105) | ellipse(45, 60, -70, 105), -80),
        (-165, 165, -110, 165),
    ),
    "an infant": (
        lambda: with_object_in_air(np.where(ellipse(55, 48), 20, air()), plate(-60, hollow=True)),
        (-55, 55, -48, 48),
    ),
    "a phantom with air in it": (lambda: np.where(np.hypot(X - 58, Y) < 8, -1000, shell(0)), (-100, 100, -100, 100)),
    "a hollow phantom": (lambda: shell(88), (-100, 100, -100, 100)),
    "a phantom in a shell": (lambda: shell(10), (-100, 100, -100, 100)),
    "a phantom in a shell, a table": (lambda: with_object_in_air(shell(10), plate(-110)), (-100, 100, -100, 100)),
    "a crop without air": (lambda: air() + 1030, (-260, 260, -200, 200)),
}


@pytest.mark.parametrize("name", CASES)
def test_whole_body_is_found(name):
    make, expected = CASES[name]
    body = find_body(Volume(np.maximum(make(), -1000).astype(np.float32), GRID))
    found = [edge for axis in (2, 1) for edge in edges_mm(GRID, axis, body.pixels_of(axis))]
    np.testing.assert_allclose(np.subtract(found, [7, 7, -30, -30]), expected, atol=6)


def test_lungs_and_their_contents_are_body_and_arms_are_not():
    hu = with_object_in_air(chest(), arms := ellipse(36, 36, 215, -20))
    body = find_body(Volume(hu.astype(np.float32), GRID))
    assert body.blocks == (1, 1, 1)
    np.testing.assert_array_equal(body.mask, ellipse(165, 110))
    np.testing.assert_array_equal(body.detached, arms & ~ellipse(165, 110))


def test_fine_voxels_give_the_same_outline_as_coarse_ones():
    """Blocks of 5 x 3 pixels: a quarter of those of a clinical CT."""
    whole = find_body(Volume(chest().astype(np.float32), GRID))
    fine = np.repeat(np.repeat(chest().astype(np.float32), 5, axis=1), 5, axis=2)
    grid = Grid(fine.shape, (8.0, 0.8, 0.8), GRID.centre_mm)
    body = find_body(Volume(fine, grid))
    assert body.blocks == (1, 2, 3)
    for axis in (1, 2):
        found, expected = edges_mm(grid, axis, body.pixels_of(axis)), edges_mm(GRID, axis, whole.pixels_of(axis))
        np.testing.assert_allclose(found, expected, atol=2.5)


def test_unscanned_slices_do_not_count():
    hu = chest()
    hu[:3] = np.where(plate(-100, 250)[:3], 200, -1000)
    body = find_body(Volume(hu.astype(np.float32), GRID), 3, 10)
    assert body.mask.shape[0] == 7 and body.first == 3
    np.testing.assert_array_equal(body.mask, ellipse(165, 110)[3:])
