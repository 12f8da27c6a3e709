"""Write my_ct/ct.nii.gz, a CT of a water cylinder with two pairs of inserts, and my_ct/labels.nii.gz, its label map."""

from pathlib import Path

import nibabel
import numpy as np

VOXEL_MM = 4.0
SHAPE = (48, 48, 16)  # x, y, z: the order of NIfTI
CENTER_MM = np.array([12, -150, 640])  # arbitrary, as in a clinical CT
INSERTS = {1: (30, 0, 50), 2: (-30, 0, 50), 3: (0, 32, 20), 4: (0, -32, 20)}  # label: x and y in mm, HU

affine = np.diag([VOXEL_MM, VOXEL_MM, VOXEL_MM, 1])
affine[:3, 3] = CENTER_MM - VOXEL_MM * (np.array(SHAPE) - 1) / 2
x, y, z = (VOXEL_MM * (i - (n - 1) / 2) for i, n in zip(np.indices(SHAPE), SHAPE, strict=True))

ct = np.where(np.hypot(x, y) < 75, 0, -1000)
labels = np.zeros(SHAPE, np.uint8)
for label, (x0, y0, hu) in INSERTS.items():
    inside = (np.hypot(x - x0, y - y0) < 16) & (abs(z) < 20)
    ct[inside], labels[inside] = hu, label

Path("my_ct").mkdir(exist_ok=True)
nibabel.save(nibabel.Nifti1Image(ct.astype(np.int16), affine), "my_ct/ct.nii.gz")
nibabel.save(nibabel.Nifti1Image(labels, affine), "my_ct/labels.nii.gz")
