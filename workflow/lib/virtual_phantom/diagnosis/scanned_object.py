"""The scanned object as a scene: the study's phantom, a disc, shapes, a label map, a mask, or images of the object."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.units import HU_AIR
from ..io import volumes
from ..io.volumes import Volume
from ..phantom import block_mean
from ..phantom.ct import read_hu
from ..phantom.plausibility import SIZE, WINDOW
from ..physics.beam.materials import Segmentation, energy_of
from ..physics.scenes.labeled import LabelMap, read_label_map
from ..physics.scenes.objects import ShapedObject, read_object
from ..physics.scenes.prism import PrismScene
from ..physics.scenes.scene import DISC_ENERGY_KEV, VoxelScene
from ..physics.scenes.shapes import DiscScene, ShapesScene
from .request import DiagnosisRequest
from .settings import LabelledObject, MaskedObject, ShapesObject

MOST_SLICES = 24  # of images; more slices add run time and little information
AIR_BELOW_HU = -900.0  # of simulated images: noise and rings of air would make the object as large as the images
PARTIAL_TOLERANCE = 1e-3  # of volume fractions beyond 0 and 1, from resampling


def scene_of(request: DiagnosisRequest) -> DiscScene | PrismScene | ShapesScene | VoxelScene:
    """Return the scene of a diagnosed recording.

    Raises
    ------
    InputError
        If the file of the object is missing or invalid.
    """
    if request.settings.simulation is not None or request.settings.of_scan:
        return simulated_object(request)
    disc, other, energy = request.settings.disc, request.settings.object, request.energy_kev or DISC_ENERGY_KEV
    if disc is not None:
        return DiscScene(disc.diameter_mm, disc.material, energy_kev=energy)
    if isinstance(other, ShapesObject):
        return ShapesScene(shaped_object(other).shapes, energy_of("water", request.mu_water_per_mm), request.threads)
    if isinstance(other, LabelledObject):
        labelled = read_label_map(other.labels, other.materials)
        return labelled_scene(labelled, energy_of("water", request.mu_water_per_mm), request.threads)
    if other is not None:
        return mask_scene(other.mask, other.material, request.threads, energy)
    volume = volumes.read_nifti(request.phantom)
    return VoxelScene.of(volume, request.materials, request.mu_water_per_mm, request.threads)


def shown_slices(stated: Sequence[int] | None, count: int) -> slice:
    """Return the stated slices of images that show the object, or the central ones."""
    away = max(0, (count - MOST_SLICES) // 2)
    return slice(away, count - away) if stated is None else slice(stated[0], stated[1] + 1)


def read_simulated_images(path: str | Path) -> Volume:
    """Read the user's own simulation of images, HU.

    Raises
    ------
    InputError
        As phantom.ct.read_hu. Images without noise may have many voxels of exactly 0 HU, and few voxels.
    """
    return read_hu(Path(path), not_checked=(WINDOW, SIZE))


def simulated_slice(request: DiagnosisRequest, which: slice = slice(None)) -> Volume:
    """Return the mean slice of the user's own simulation of images, or of another scan, HU.

    Parameters
    ----------
    which : slice, optional
        Slices that are averaged, among those that show the object.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    volume = request.other_scan or read_simulated_images(request.settings.simulation)
    count = len(volume.array)
    slices = shown_slices(request.settings.slices if count > 1 else None, count)
    hu = volume.array[slices][which].mean(axis=0, keepdims=True, dtype=np.float64)
    return Volume(hu, Grid(hu.shape, volume.grid.spacing))


def simulated_object(request: DiagnosisRequest, which: slice = slice(None)) -> PrismScene:
    """Return the mean slice of the user's own simulation of images, or of another scan, as an object.

    For the argument see simulated_slice.

    Raises
    ------
    InputError
        If it cannot be read or shows nothing but air.
    """
    simulated, materials = simulated_slice(request, which), request.materials
    hu = np.where(simulated.array[0] < AIR_BELOW_HU, HU_AIR, simulated.array[0])
    if not (hu > HU_AIR).any():
        path = request.settings.object.scan if request.settings.of_scan else request.settings.simulation
        raise InputError(f"{path}: shows nothing but air; give images in HU")
    shares, energy = materials.fractions(hu, request.mu_water_per_mm), energy_of("water", request.mu_water_per_mm)
    return PrismScene(shares, simulated.grid, materials.materials, energy)


def shaped_object(given: ShapesObject) -> ShapedObject:
    """Read an object of shapes."""
    return read_object(given.kind, given.parameters)


def binary_voxels_remark(request: DiagnosisRequest, scene: object) -> str | None:
    """Return a remark on an object whose voxels have no partial volumes, with a better choice; None for others."""
    other = request.settings.object
    if not isinstance(other, MaskedObject | LabelledObject) or not scene.is_binary:
        return None
    if isinstance(other, LabelledObject):
        drawn, better = other.labels, "finer voxels or an object of shapes"
    else:
        drawn, better = other.mask, "finer voxels, shares of voxels (0 to 1) or an object of shapes"
    along = [f"{side:.3g}" for side in scene.grid.spacing[::-1]][: 2 if isinstance(scene, PrismScene) else 3]
    size = along[0] if len(set(along)) == 1 else " x ".join(along)
    return f"as caused by the voxels of {Path(drawn).name} ({size} mm); {better}"


def coarse_scene(phantom: str | Path, mu_water_per_mm: float, materials: Segmentation, threads: int = 1) -> VoxelScene:
    """Return the study's phantom with voxels of twice the size, which shows the effect of voxels on line integrals.

    Each voxel is the mean of eight. A side with an odd number of voxels gets one more plane of air, and the grid keeps
    its place.

    Arguments are as in DiagnosisRequest.
    """
    volume = volumes.read_nifti(phantom)
    odd = [n % 2 for n in volume.grid.shape]
    padded = np.pad(volume.array, [(0, more) for more in odd], constant_values=HU_AIR)
    spacing = tuple(2 * step for step in volume.grid.spacing)
    coarse = Volume(block_mean(padded, 2), Grid(tuple(n // 2 for n in padded.shape), spacing))
    scene = VoxelScene.of(coarse, materials, mu_water_per_mm, threads)
    return scene.moved(np.array([more * step / 2 for more, step in zip(odd, volume.grid.spacing, strict=True)])[::-1])


def mask_scene(
    mask: str | Path, material: str, threads: int = 1, energy_kev: float = DISC_ENERGY_KEV
) -> VoxelScene | PrismScene:
    """Return the scene of a homogeneous object.

    A single slice describes an object that is constant along z and longer than the beam height.

    Parameters
    ----------
    mask : str or Path
        Image of volume fractions (0 to 1), with its center at the isocenter.

    Raises
    ------
    InputError
        If the mask is missing, broken, empty, or holds values outside 0 to 1.
    """
    volume = read_mask(mask)
    return labelled_scene(LabelMap(volume.array[None], volume.grid, (material,)), energy_kev, threads)


def labelled_scene(labelled: LabelMap, energy_kev: float, threads: int = 1) -> VoxelScene | PrismScene:
    """Return the scene of a label map; for a single slice see mask_scene.

    Parameters
    ----------
    energy_kev : float
        Energy of the monochromatic beam, keV. The ratio of the attenuation of two materials depends on it.
    """
    shares, grid, materials = labelled.shares, labelled.grid, labelled.materials
    if grid.shape[0] == 1:
        return PrismScene(shares[:, 0], grid, materials, energy_kev)
    return VoxelScene(shares, grid, materials, energy_kev, threads)


def read_mask(mask: str | Path) -> Volume:
    """Read the volume fractions of mask_scene, as float32.

    Raises
    ------
    InputError
        If the mask is missing, broken, empty, or holds values outside 0 to 1.
    """
    volume = volumes.read_nifti(mask)
    share, grid = volume.array, volume.grid
    if not np.isfinite(share).all() or share.min() < -PARTIAL_TOLERANCE or share.max() > 1 + PARTIAL_TOLERANCE:
        raise InputError(f"{mask}: holds values outside 0 to 1; give the share of every voxel that the object fills")
    if not share.max() > 0:
        raise InputError(f"{mask}: is empty; mark the voxels that the object fills with 1")
    return Volume(np.clip(share, 0, 1).astype(np.float32), grid)
