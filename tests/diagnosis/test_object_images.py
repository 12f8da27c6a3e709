"""Images of a known object: slices as repeats, reconstructed by another program from an analytic sinogram."""

import numpy as np
import pytest
import yaml
from skimage.measure import block_reduce
from skimage.transform import iradon

import virtual_phantom as vp
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.beam.materials import attenuation_per_mm, energy_of

WATER_PER_MM = defaults_of()["mu_water_per_mm"]
ENERGY_KEV = energy_of("water", WATER_PER_MM)
# x, y, diameter in mm, and material. Later discs replace earlier ones.
DISCS = [(0, 0, 100, "water"), (28, 6, 22, "pmma"), (-18, 24, 16, "polyethylene"), (-10, -28, 18, "soft_tissue")]
SIDE, VOXEL_MM, FINE, VIEWS, SLICES = 64, 2.0, 3, 240, 10
MOVED = (3.2, -1.7)  # x, y, mm


def line_integrals(t_mm, angles_rad):
    """Parallel projections, shape (t, angles), of the discs, moved, per mm of attenuation."""
    total = np.zeros((len(t_mm), len(angles_rad)))
    for number, (x, y, diameter, material) in enumerate(DISCS):
        mu = attenuation_per_mm(material, [ENERGY_KEV])[0] - (WATER_PER_MM if number else 0)
        center = (x + MOVED[0]) * np.cos(angles_rad) + (y + MOVED[1]) * np.sin(angles_rad)
        total += mu * 2 * np.sqrt(np.maximum((diameter / 2) ** 2 - (t_mm[:, None] - center) ** 2, 0))
    return total


def reconstructed(lines, pixel_mm, filter_name):
    """Filtered back-projection by scikit-image, HU, rows along +y."""
    degrees = np.arange(VIEWS) * 180 / VIEWS
    image = iradon(lines, degrees, filter_name=filter_name, interpolation="cubic")[::-1] / pixel_mm
    return 1000 * (image / WATER_PER_MM - 1)


def images(filter_name="ramp", noise=0.004, seed=1):
    """Noisy slices, HU, shape (z, y, x), of voxels that average the image."""
    random, angles = np.random.default_rng(seed), np.arange(VIEWS) * np.pi / VIEWS
    pixel = VOXEL_MM / FINE
    t = (np.arange(SIDE * FINE) - SIDE * FINE // 2) * pixel

    clean = reconstructed(line_integrals(t, angles), pixel, filter_name)
    clean = block_reduce(clean, (FINE, FINE), np.mean)
    noisy = [
        clean + 1000 + reconstructed(noise * random.standard_normal((SIDE, VIEWS)), VOXEL_MM, filter_name)
        for _ in range(SLICES)
    ]
    return np.array(noisy)


@pytest.fixture
def diagnosed(tmp_path):
    """Return a function that writes slices as a recording and diagnoses them."""
    shapes = [
        {"kind": "cylinder", "material": material, "centre_mm": [x, y, 0], "diameter_mm": diameter}
        for x, y, diameter, material in DISCS
    ]
    (tmp_path / "discs.yaml").write_text(yaml.safe_dump({"description": "Discs.", "shapes": shapes}))

    def diagnose(slices, **settings):
        grid = Grid(slices.shape, (2.5, VOXEL_MM, VOXEL_MM))
        write_nifti(Volume(np.rint(slices).astype(np.int16), grid), tmp_path / "images.nii.gz")
        content = {"name": "discs", "kind": "images", "repeats": ["images.nii.gz"]}
        (tmp_path / "recording.yaml").write_text(yaml.safe_dump(content))
        found = vp.diagnose(tmp_path, shapes=str(tmp_path / "discs.yaml"), effects=EFFECTS, **settings)
        return found.content

    return diagnose


EFFECTS = ["hu_calibration", "reconstruction_kernel", "scatter"]
