"""White noise on a phantom."""

import numpy as np
import pytest

from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import root
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom.white_noise import add_white_noise


def test_noise_has_the_variance_of_each_roi_and_is_white():
    image = Volume(np.full((20, 40, 60), 50, np.float32), Grid((20, 40, 60), (1.0, 1.0, 1.0)))
    masks = {name: np.zeros(image.array.shape, bool) for name in ("cyst", "liver")}
    masks["cyst"][:, :, :20], masks["liver"][:, :, 20:40] = True, True
    noisy = add_white_noise(image, masks, {"cyst": 100.0, "liver": 400.0}, root(1))
    noise = noisy.array - 50.0
    for part, sd in ((masks["cyst"], 10), (masks["liver"], 20), (~masks["cyst"] & ~masks["liver"], 15)):
        assert noise[part].std() == pytest.approx(sd, rel=0.03)
        assert noise[part].mean() == pytest.approx(0, abs=4 * sd / np.sqrt(part.sum()))
    cyst = noise[:, :, :20]
    assert np.mean(cyst[1:] * cyst[:-1]) == pytest.approx(0, abs=4 * 100 / np.sqrt(cyst[1:].size))
    assert np.array_equal(add_white_noise(image, masks, {"cyst": 100.0, "liver": 400.0}, root(1)).array, noisy.array)
