"""Sub-regions and noise of the acrylic cartridge, against closed forms and the published features."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import uniform_cartridge as cartridge
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.streams import root

TABLE = Path(__file__).resolve().parents[2] / "../shared/real/ccr1_features/features_ge.csv"


@pytest.mark.parametrize(
    ("voxels", "field_mm", "thickness", "shape"),
    [
        (13440, 250, 2.5, (8, 40, 42)),
        (5200, 400, 2.5, (8, 25, 26)),
        (3360, 500, 2.5, (8, 20, 21)),
        (16 * 28 * 28, 360, 1.25, (16, 28, 28)),
    ],
)
def test_a_box_has_the_voxels_and_the_volume_of_the_table(voxels, field_mm, thickness, shape):
    pixel = field_mm / 512
    found = cartridge.box(voxels, thickness * pixel**2)
    assert found.shape == shape
    assert found.spacing == pytest.approx((thickness, pixel, pixel))


def test_no_box_of_a_prime_number_of_voxels():
    with pytest.raises(InputError, match="13441 voxels"):
        cartridge.box(13441, 2.5 * (250 / 512) ** 2)


def test_images_have_their_means_and_the_mean_variance_after_rounding():
    boxes = [cartridge.Box((8, 40, 42), (2.5, 0.4883, 0.4883))] * 3
    images = cartridge.images(cartridge.correlated(4.2, 2.5), boxes, [121.0, 122.5, 124.0], 35.0, root(1))
    assert [image.mean() for image in images] == pytest.approx([121.0, 122.5, 124.0], abs=1e-3)
    assert np.mean([np.rint(image).var() for image in images]) == pytest.approx(35.0, rel=0.01)


@pytest.mark.real
@pytest.mark.skipif(not TABLE.exists(), reason="the table of the cartridge phantom is not beside the checkout")
def test_correlated_noise_predicts_scanner_1_better_than_white_noise():
    rows = cartridge.read(TABLE, [1]).loc[1]
    assert {one.shape for one in rows["box"]} == {(8, 40, 42)}
    chosen = cartridge.fitted_regions(rows)
    known, held_out = rows[chosen], rows[~chosen].drop(columns="box").astype(float)
    variance = known[cartridge.VARIANCE].mean()
    shares = []
    for model in (cartridge.correlated(4.29, 2.5), None):  # MTF50 as fitted by the benchmark
        predicted = cartridge.predict(model, known, variance, root(2), realizations=2)[held_out.columns]
        shares.append(100 * cartridge.within(predicted, held_out).mean())
    assert shares[0] > 90  # the benchmark: 98.9 and 56.0 %
    assert shares[1] < 70
