"""Objects from label maps: images of whole numbers, each of which is a material."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...base.errors import InputError, did_you_mean
from ...base.geometry import Grid
from ...io.volumes import Volume, read_nifti
from ..beam.material_names import COMPOUNDS, ELEMENTS, library_name
from ..beam.materials import Material, Mixture
from .shapes import NOTHING

BACKGROUND = 0  # label without material, unless the configuration names one
MAX_LISTED = 10  # labels in a message: an image of gray values has thousands


@dataclass(frozen=True)
class LabelMap:
    """An object of voxels with one material or none each.

    Attributes
    ----------
    shares : ndarray of float32, shape (materials, z, y, x)
        1 if a voxel has the material, else 0.
    """

    shares: np.ndarray
    grid: Grid
    materials: tuple[Material, ...]


def label_materials(entries: Mapping[str, str | Mapping]) -> dict[int, Material]:
    """Return the material of every label. Materials with the same definition are equal.

    Parameters
    ----------
    entries : mapping of str to str or mapping
        {label in digits: name of a library material, "nothing", or a definition: density_g_per_cm3, and compound or
        mass_fractions}.

    Raises
    ------
    InputError
        For an unknown name, or an invalid definition.
    """
    found = {}
    for label, entry in entries.items():
        try:
            found[int(label)] = _library_material(entry) if isinstance(entry, str) else _mixture(entry)
        except InputError as error:
            raise InputError(f"materials.{label}: {error}") from None
    return found


def _library_material(name: str) -> str:
    known = [*COMPOUNDS, *ELEMENTS, NOTHING]
    if library_name(name) not in known:
        raise InputError(f"material '{name}' is unknown; {did_you_mean(name, known)}")
    return library_name(name)


def _mixture(entry: Mapping) -> Mixture:
    density, compound = float(entry["density_g_per_cm3"]), entry.get("compound")
    fractions = tuple(sorted(entry.get("mass_fractions", {}).items()))
    # The name is the composition, not the label, so that labels with the same definition are one material.
    parts = [compound] if compound else [f"{symbol} {share:g}" for symbol, share in fractions]
    return Mixture(f"{', '.join(parts)} ({density:g} g/cm3)".lstrip(), density, compound, fractions)


def read_label_map(path: str | Path, entries: Mapping[str, str | Mapping]) -> LabelMap:
    """Read the object of a label map.

    Parameters
    ----------
    path : str or Path
        NIfTI image of whole numbers of at least 0.
    entries : mapping of str to str or mapping
        As label_materials takes it. Label 0 is empty if it has no entry.

    Returns
    -------
    LabelMap
        Materials are sorted by name, so that sums over them do not depend on the labels.

    Raises
    ------
    InputError
        As label_materials; if the map is missing, broken, not of labels or empty; or if a label has no material.
    """
    materials = label_materials(entries)
    volume, labels = _read_labels(path)
    _check_all_named(path, labels, materials)
    labels_of: dict[Material, list[int]] = {}
    for label in labels:
        material = materials.get(label, NOTHING)
        if material != NOTHING:
            labels_of.setdefault(material, []).append(label)
    if not labels_of:
        raise InputError(f"{path}: holds no label of a material; name one under materials that is not '{NOTHING}'")
    ordered = sorted(labels_of, key=str)
    shares = np.empty((len(ordered), *volume.grid.shape), np.float32)
    for share, material in zip(shares, ordered, strict=True):
        share[...] = np.isin(volume.array, labels_of[material])
    return LabelMap(shares, volume.grid, tuple(ordered))


def _read_labels(path: str | Path) -> tuple[Volume, list[int]]:
    """Return a label map and its labels."""
    volume = read_nifti(path, dtype=None)
    values = np.unique(volume.array)
    if not np.isfinite(values).all():
        raise InputError(f"{path}: holds NaN or infinite values; give a whole number for every voxel")
    if (broken := values[values != np.round(values)]).size:
        raise InputError(
            f"{path}: holds {broken[0]:g}, which is no label; give whole numbers, or shares of one material as a mask"
        )
    if values[0] < 0:
        raise InputError(f"{path}: holds the label {int(values[0])}; give whole numbers from 0 on")
    return Volume(volume.array.astype(np.int64, copy=False), volume.grid), [int(value) for value in values]


def _check_all_named(path: str | Path, labels: Sequence[int], materials: Mapping[int, Material]) -> None:
    missing = [str(label) for label in labels if label not in materials and label != BACKGROUND]
    if not missing:
        return
    listed = missing[:MAX_LISTED]
    rest = f" ... ({len(missing)} labels)" if len(missing) > len(listed) else ""
    what = f"label {listed[0]} has" if len(missing) == 1 else f"labels {', '.join(listed)}{rest} have"
    raise InputError(f"{path}: its {what} no material; name one for each under materials ('{NOTHING}' for empty space)")
