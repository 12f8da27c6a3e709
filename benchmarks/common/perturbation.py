"""Image perturbation by the recipe of Zwanenburg et al., Sci. Rep. 9, 614, 2019: the image and its region change."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.restoration import estimate_sigma


def signed_distance(mask: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    """Distance (mm) from the surface of a region, negative inside."""
    return ndimage.distance_transform_edt(~mask, spacing) - ndimage.distance_transform_edt(mask, spacing)


def perturb(clean: np.ndarray, distance: np.ndarray, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One random perturbation of an image [z, y, x] and of the region with this `signed_distance`.

    Rotation by up to 4 degrees about z and a shift of up to half a voxel, with linear interpolation. The size of the
    region changes by up to 20 %. The Gaussian noise has the SD that wavelets find in the image. The region needs a
    margin in the image; its distance may have fewer axes than the image.
    """
    sd = np.nan_to_num(estimate_sigma(clean))  # NaN for a uniform region
    image = ndimage.rotate(clean, random.uniform(-4, 4), (1, 2), reshape=False, order=1, mode="nearest")
    image = ndimage.shift(image, random.uniform(-0.5, 0.5, 3), order=1, mode="nearest")
    image = image + random.normal(0, sd, image.shape)
    voxels = int(round((distance < 0).sum() * (1 + random.uniform(-0.2, 0.2))))
    changed = distance <= np.partition(distance.ravel(), voxels)[voxels]
    return image.astype(np.float32), changed
