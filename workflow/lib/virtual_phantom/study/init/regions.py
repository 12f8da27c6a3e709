"""The regions that are drawn on a CT, each with its size, CT numbers and place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import find_objects

from ...base.errors import InputError
from ...base.geometry import Grid
from ...io.volumes import Volume
from ...phantom.masks import open_regions

GAS_HU = -300.0  # less dense than fat (-100) by more than noise: gas, or lung
LONGEST_NAME = 56  # of a region; with the number of a part 64, as the schema allows
# Words of a name that say which one of several of a tissue it is: a side, a number, a vertebra or a rib.
ONE_OF_SEVERAL = re.compile(r"^(left|right|l|r|\d+|[ctls]\d+)$", re.IGNORECASE)


@dataclass(frozen=True)
class Region:
    """A region of a CT.

    Attributes
    ----------
    name : str
        Of letters, digits and underscores.
    tissue_class : str
        The name without side and number.
    file : str
        Where it is drawn.
    label : int, str or None
        Which region of the file.
    box : tuple of 3 slice
        Where it lies in the CT, (z, y, x).
    mask : ndarray of bool
        Within the box.
    volume_ml : float
    mean_hu, sd_hu : float
    gas_share : float
        Of its voxels, those under GAS_HU.
    grid : Grid
        The CT's.
    """

    name: str
    tissue_class: str
    file: str
    label: int | str | None
    box: tuple[slice, slice, slice]
    mask: np.ndarray
    volume_ml: float
    mean_hu: float
    sd_hu: float
    gas_share: float
    grid: Grid

    @property
    def voxels(self) -> int:
        """How many of the CT's voxels it has."""
        return int(np.count_nonzero(self.mask))

    @property
    def extent_mm(self) -> tuple[float, float, float]:
        """Edge lengths of its box, mm (z, y, x)."""
        return tuple((s.stop - s.start) * wide for s, wide in zip(self.box, self.grid.spacing, strict=True))

    @property
    def bounds_mm(self) -> tuple[tuple[float, float], ...]:
        """From where to where it reaches, outer edges of its voxels, NIfTI world mm: z, y, x."""
        return tuple(
            (
                centre + (s.start - n / 2) * wide,
                centre + (s.stop - n / 2) * wide,
            )
            for s, n, wide, centre in zip(
                self.box, self.grid.shape, self.grid.spacing, self.grid.centre_mm[::-1], strict=True
            )
        )

    def slice(self, z: int) -> np.ndarray:
        """One slice of the CT, bool [y, x]."""
        full = np.zeros(self.grid.shape[1:], bool)
        if self.box[0].start <= z < self.box[0].stop:
            full[self.box[1:]] = self.mask[z - self.box[0].start]
        return full

    def says(self, label: object) -> bool:
        """Whether a user means this region: by its label or its name."""
        return str(label) in (str(self.label), self.name)


def read_regions(image: Volume, labels: str | Path, names: Mapping[str, str]) -> list[Region]:
    """Every region of a file, or of a folder of masks.

    Parameters
    ----------
    image : Volume
        The CT, HU.
    labels : str or Path
        Label map or mask (NIfTI), DICOM SEG, RTSTRUCT, or a folder of NIfTI masks with a file each. Empty masks and
        empty regions are passed over.
    names : mapping of str to str
        {label: name} that replace the file's own.

    Returns
    -------
    list of Region
        In the order of the file.

    Raises
    ------
    InputError
        For what cannot be read, a name of `names` for a label that is not there or that is not of letters, digits and
        underscores, a name given twice, and where there is no region at all.
    """
    labels = Path(labels)
    found: list[Region] = []
    unused = dict(names)
    for path in _files(labels):
        reader = open_regions(path, image.grid)
        there = reader.there()
        alone = labels.is_dir() and len(there) == 1
        for label, named in there.items():
            mask = reader.mask(label)
            if not mask.any():
                continue
            known = (str(label), str(named), _stem(path)) if alone else (str(label), str(named))
            given = next((unused.pop(one) for one in known if one in unused), None)
            own = (_stem(path) if alone else named) or f"label_{label}"
            found.append(_region(image, mask, _name(given, own), str(path), None if alone else label))
    if not found:
        raise InputError(f"{labels}: holds no region; draw some on the CT")
    if unused:
        there = ", ".join(str(region.label if region.label is not None else region.name) for region in found)
        raise InputError(f"--names: {labels} has no region '{next(iter(unused))}'; there are: {there}")
    doubled = [region.name for region in found]
    for name in doubled:
        if doubled.count(name) > 1:
            raise InputError(f"{labels}: two regions would be called {name}; tell them apart by --names LABEL=NAME")
    return found


def _files(labels: Path) -> list[Path]:
    if not labels.is_dir():
        return [labels]
    masks = sorted(path for path in labels.iterdir() if path.name.endswith((".nii", ".nii.gz")))
    if not masks:
        raise InputError(f"{labels}: holds no NIfTI mask (.nii, .nii.gz); give a file of regions or a folder of masks")
    return masks


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").removesuffix(".nii")


def _name(given: str | None, own: str) -> str:
    """A name that files and tables can have; one that a user has given must be such a name already."""
    if given is not None:
        if not re.fullmatch(rf"[A-Za-z0-9_]{{1,{LONGEST_NAME}}}", given):
            raise InputError(f"--names: '{given}' must be of letters, digits and underscores, {LONGEST_NAME} at most")
        return given
    return re.sub(r"[^A-Za-z0-9]+", "_", own).strip("_")[:LONGEST_NAME].lower() or "region"


def tissue_class(name: str) -> str:
    """The name of a region without the words that say which one of several it is: muscle of muscle_left."""
    words = [word for word in name.split("_") if not ONE_OF_SEVERAL.match(word)]
    return name if not words or words == ["label"] else "_".join(words)


def _region(image: Volume, mask: np.ndarray, name: str, file: str, label: int | str | None) -> Region:
    (box,) = find_objects(mask.astype(np.uint8))
    values = image.array[box][mask[box]].astype(np.float64)
    return Region(
        name=name,
        tissue_class=tissue_class(name),
        file=file,
        label=label,
        box=box,
        mask=mask[box].copy(),
        volume_ml=values.size * image.grid.voxel_volume_mm3 / 1000,
        mean_hu=float(values.mean()),
        sd_hu=float(values.std()),
        gas_share=float((values < GAS_HU).mean()),
        grid=image.grid,
    )
