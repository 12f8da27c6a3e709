"""Objects of labels: a map of whole numbers, and the material that each of them stands for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...base.errors import InputError, meant
from ...base.geometry import Grid
from ...io.volumes import Volume, read_nifti
from ..beam.material_names import COMPOUNDS, ELEMENTS, named
from ..beam.materials import Material, Mixture
from .shapes import NOTHING

BACKGROUND = 0  # the label of what is left out, unless a material is named for it
MOST_NAMED = 10  # labels in a message: an image of grey values has thousands


@dataclass(frozen=True)
class Labelled:
    """An object of voxels that are each of one material, or of nothing.

    Attributes
    ----------
    shares : ndarray of float32, shape (materials, z, y, x)
        1 where a voxel is of the material, else 0.
    """

    shares: np.ndarray
    grid: Grid
    materials: tuple[Material, ...]


def materials_of(entries: Mapping[str, str | Mapping]) -> dict[int, Material]:
    """The material of every label.

    Parameters
    ----------
    entries : mapping of str to str or mapping
        {label in digits: name of one of the library's, "nothing", or a definition: density_g_per_cm3, and compound or
        mass_fractions}.

    Returns
    -------
    dict of int to (str or Mixture)
        Those that are defined alike are equal.

    Raises
    ------
    InputError
        For an unknown name, and a definition that Mixture refuses.
    """
    found = {}
    for label, entry in entries.items():
        try:
            found[int(label)] = _named(entry) if isinstance(entry, str) else _defined(entry)
        except InputError as error:
            raise InputError(f"materials.{label}: {error}") from None
    return found


def _named(name: str) -> str:
    known = [*COMPOUNDS, *ELEMENTS, NOTHING]
    if named(name) not in known:
        raise InputError(f"material '{name}' is unknown; {meant(name, known)}")
    return named(name)


def _defined(entry: Mapping) -> Mixture:
    density, compound = float(entry["density_g_per_cm3"]), entry.get("compound")
    fractions = tuple(sorted(entry.get("mass_fractions", {}).items()))
    # Named by what it is, not by its label: labels of one definition are one material.
    parts = [compound] if compound else [f"{symbol} {share:g}" for symbol, share in fractions]
    return Mixture(f"{', '.join(parts)} ({density:g} g/cm3)".lstrip(), density, compound, fractions)


def read_labelled(path: str | Path, entries: Mapping[str, str | Mapping]) -> Labelled:
    """The object of a label map.

    Parameters
    ----------
    path : str or Path
        NIfTI image of whole numbers from 0 on.
    entries : mapping of str to str or mapping
        As materials_of takes it. Label 0 is nothing where it has no entry.

    Returns
    -------
    Labelled
        Materials in the order of their names, whatever their labels: sums over them do not depend on these.

    Raises
    ------
    InputError
        As materials_of; if the map is missing or broken, is none of labels, has a label without a material, or holds
        nothing.
    """
    materials = materials_of(entries)
    labels, there = _read(path)
    _check_all_named(path, there, materials)
    of: dict[Material, list[int]] = {}
    for label in there:
        material = materials.get(label, NOTHING)
        if material != NOTHING:
            of.setdefault(material, []).append(label)
    if not of:
        raise InputError(f"{path}: holds no label of a material; name one under materials that is not '{NOTHING}'")
    ordered = sorted(of, key=str)
    shares = np.empty((len(ordered), *labels.grid.shape), np.float32)
    for place, material in enumerate(ordered):
        shares[place] = np.isin(labels.array, of[material])
    return Labelled(shares, labels.grid, tuple(ordered))


def _read(path: str | Path) -> tuple[Volume, list[int]]:
    """A label map, and the labels that it holds."""
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
    return Volume(volume.array.astype(np.int64, copy=False), volume.grid), [int(one) for one in values]


def _check_all_named(path: str | Path, there: Sequence[int], materials: Mapping[int, Material]) -> None:
    missing = [str(label) for label in there if label not in materials and label != BACKGROUND]
    if not missing:
        return
    some = missing[:MOST_NAMED]
    rest = f" ... ({len(missing)} labels)" if len(missing) > len(some) else ""
    what = f"label {some[0]} has" if len(missing) == 1 else f"labels {', '.join(some)}{rest} have"
    raise InputError(f"{path}: its {what} no material; name one for each under materials ('{NOTHING}': it is left out)")
