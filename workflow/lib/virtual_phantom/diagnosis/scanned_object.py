"""What was scanned, as a scene: the study's phantom, a disc, or an object of shapes, of a label map or of a mask."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_AIR
from ..io import volumes
from ..io.volumes import Volume
from ..phantom import block_mean
from ..physics.beam.materials import Segmentation, energy_of
from ..physics.scenes.labeled import Labelled, read_labelled
from ..physics.scenes.objects import ShapedObject, read_object
from ..physics.scenes.prism import PrismScene
from ..physics.scenes.scene import DISC_ENERGY_KEV, DiscScene, VoxelScene
from ..physics.scenes.shapes import ShapesScene
from .request import DiagnosisRequest, LabelledObject, MaskedObject, ShapesObject

PARTIAL_TOLERANCE = 1e-3  # beyond 0 and 1, of shares: what resampling leaves


def scene_of(asked: DiagnosisRequest) -> DiscScene | PrismScene | ShapesScene | VoxelScene:
    """The scene of a diagnosed recording.

    Raises
    ------
    InputError
        As mask_scene, physics.labelled.read_labelled and physics.objects.read_object.
    """
    disc, other = asked.settings.disc, asked.settings.object
    if disc is not None:
        return DiscScene(disc.diameter_mm, disc.material)
    if isinstance(other, ShapesObject):
        return ShapesScene(shaped_object(other).shapes, energy_of("water", asked.mu_water_per_mm), asked.threads)
    if isinstance(other, LabelledObject):
        return labelled_scene(labelled_object(other), energy_of("water", asked.mu_water_per_mm), asked.threads)
    if other is not None:
        return mask_scene(other.mask, other.material, asked.threads)
    volume = volumes.read_nifti(asked.phantom)
    return VoxelScene.of(volume, Segmentation(**asked.materials), asked.mu_water_per_mm, asked.threads)


def shaped_object(asked: ShapesObject) -> ShapedObject:
    """As physics.objects.read_object."""
    return read_object(asked.kind, asked.parameters)


def labelled_object(asked: LabelledObject) -> Labelled:
    """As physics.labelled.read_labelled."""
    return read_labelled(asked.labels, asked.materials)


def whole_voxels(asked: DiagnosisRequest, scene: object) -> str | None:
    """The voxels that an object is drawn in, if none of them is filled in part.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods: that of `asked`.

    Returns
    -------
    str or None
        What they are, and what would be nearer to the object's edges, in words; None of any other object.
    """
    other = asked.settings.object
    if not isinstance(other, MaskedObject | LabelledObject) or not scene.whole_voxels:
        return None
    if isinstance(other, LabelledObject):
        drawn, better = other.labels, "finer voxels or an object of shapes"
    else:
        drawn, better = other.mask, "finer voxels, shares of voxels (0 to 1) or an object of shapes"
    along = [f"{side:.3g}" for side in scene.grid.spacing[::-1]][: 2 if isinstance(scene, PrismScene) else 3]
    size = along[0] if len(set(along)) == 1 else " x ".join(along)
    return f"as the voxels of {Path(drawn).name} ({size} mm) leave it: {better}"


def coarse_scene(phantom: str | Path, mu_water_per_mm: float, materials: dict, threads: int = 1) -> VoxelScene:
    """The study's phantom with voxels twice as large, each the mean of eight: what voxels do to line integrals.

    A side of an odd number of voxels gets a plane of air more, and the grid stays where it was.

    Parameters
    ----------
    phantom : str or Path
        Image of it, HU.
    mu_water_per_mm : float
        Of the monochromatic beam, 1/mm.
    materials : dict
        As Asked.materials.
    """
    volume = volumes.read_nifti(phantom)
    odd = [n % 2 for n in volume.grid.shape]
    padded = np.pad(volume.array, [(0, more) for more in odd], constant_values=HU_AIR)
    spacing = tuple(2 * step for step in volume.grid.spacing)
    coarse = Volume(block_mean(padded, 2), Grid(tuple(n // 2 for n in padded.shape), spacing))
    scene = VoxelScene.of(coarse, Segmentation(**materials), mu_water_per_mm, threads)
    return scene.moved(np.array([more * step / 2 for more, step in zip(odd, volume.grid.spacing, strict=True)])[::-1])


def mask_scene(mask: str | Path, material: str, threads: int = 1) -> VoxelScene | PrismScene:
    """A homogeneous object.

    A single slice stands for an object that is alike along z and longer than the beam is high.

    Parameters
    ----------
    mask : str or Path
        Image of the share of every voxel (0 to 1) that the object fills, its centre at the isocentre.

    Raises
    ------
    InputError
        If the mask is missing, broken, empty, or holds values outside 0 to 1.
    """
    volume = read_mask(mask)
    if volume.grid.shape[0] == 1:
        return PrismScene(volume.array, volume.grid, (material,))
    return VoxelScene(volume.array[None], volume.grid, (material,), DISC_ENERGY_KEV, threads)


def labelled_scene(labelled: Labelled, energy_kev: float, threads: int = 1) -> VoxelScene | PrismScene:
    """An object of a label map; a single slice stands for what mask_scene says.

    Parameters
    ----------
    energy_kev : float
        Of the monochromatic beam, keV. Unlike that of one material, it is no mere scale: how much more one material
        attenuates than another depends on it.
    """
    shares, grid = labelled.shares, labelled.grid
    if grid.shape[0] == 1:
        return PrismScene(shares[:, 0], grid, labelled.materials, energy_kev)
    return VoxelScene(shares, grid, labelled.materials, energy_kev, threads)


def read_mask(mask: str | Path) -> Volume:
    """The shares of mask_scene.

    Returns
    -------
    Volume
        float32.

    Raises
    ------
    InputError
        As mask_scene.
    """
    volume = volumes.read_nifti(mask)
    share, grid = volume.array, volume.grid
    if not np.isfinite(share).all() or share.min() < -PARTIAL_TOLERANCE or share.max() > 1 + PARTIAL_TOLERANCE:
        raise InputError(f"{mask}: holds values outside 0 to 1; give the share of every voxel that the object fills")
    if not share.max() > 0:
        raise InputError(f"{mask}: is empty; mark the voxels that the object fills with 1")
    return Volume(np.clip(share, 0, 1).astype(np.float32), grid)
