"""Segmented regions of a CT, each with its size, CT numbers and position."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...base.console import note, progress
from ...base.errors import InputError, did_you_mean
from ...base.geometry import Grid
from ...base.names import counted
from ...io.volumes import Volume, suffix_of
from ...phantom.dicom_files import not_dicom, read_header
from ...phantom.masks import KINDS, open_regions
from ...phantom.regions import ONE_BY_ONE, CroppedRegion, report

GAS_HU = -300.0  # gas or lung: below fat (-100) by more than the noise
LONGEST_NAME = 56  # the schema allows 64 with the number of a part
# Words in a name that distinguish regions of the same tissue: a side, a number, a vertebra or a rib.
ONE_OF_SEVERAL = re.compile(r"^(left|right|l|r|\d+|[ctls]\d+)$", re.IGNORECASE)
NAMELESS = ("label", "region", "roi")  # names that keep their number, because it alone identifies the tissue
# Latin letters that Unicode does not decompose into an ASCII letter and an accent.
LETTERS = str.maketrans(
    {"ø": "o", "ł": "l", "đ": "d", "ð": "d", "þ": "th", "æ": "ae", "œ": "oe", "ı": "i", "µ": "u", "μ": "u"}
)


@dataclass(frozen=True)
class Region:
    """Region of a CT.

    Attributes
    ----------
    name : str
        Name with letters, digits and underscores.
    tissue_class : str
        Name without side and number.
    file : str
        File with the segmentation.
    label : int, str or None
        Label in the file; None for a file with one mask.
    box : tuple of 3 slice
        Bounding box in the CT, (z, y, x).
    mask : ndarray of bool
        Mask inside the box.
    gas_share : float
        Fraction of voxels below GAS_HU.
    grid : Grid
        Grid of the CT.
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
        """Number of voxels of the CT."""
        return int(np.count_nonzero(self.mask))

    @property
    def extent_mm(self) -> tuple[float, float, float]:
        """Edge lengths of the box, mm (z, y, x)."""
        return tuple((s.stop - s.start) * wide for s, wide in zip(self.box, self.grid.spacing, strict=True))

    @property
    def bounds_mm(self) -> tuple[tuple[float, float], ...]:
        """Limits of the box (outer edges of voxels), NIfTI world mm: z, y, x."""
        return tuple(
            (center + (s.start - n / 2) * wide, center + (s.stop - n / 2) * wide)
            for s, n, wide, center in zip(
                self.box, self.grid.shape, self.grid.spacing, self.grid.centre_mm[::-1], strict=True
            )
        )

    def slice(self, z: int) -> np.ndarray:
        """Return the mask on one slice of the CT, bool [y, x]."""
        full = np.zeros(self.grid.shape[1:], bool)
        if self.box[0].start <= z < self.box[0].stop:
            full[self.box[1:]] = self.mask[z - self.box[0].start]
        return full


@dataclass(frozen=True)
class _FoundRegion:
    """Region of a file whose voxels are not read yet."""

    path: Path
    label: int | str | None
    original_name: str  # given by the file or by the name of the file
    aliases: tuple[str, ...]  # names that an option may use for it
    crop: Callable[[], CroppedRegion | None]


def read_regions(
    image: Volume, labels: str | Path, names: Mapping[str, str], rois: Sequence[str] = (), fill_gaps: bool = False
) -> list[Region]:
    """Read the regions of a file or of a folder of masks.

    Without `rois`, regions that are empty or cannot be read are skipped with a note.

    Parameters
    ----------
    image : Volume
        The CT, HU.
    labels : str or Path
        Label map or mask (NIfTI, NRRD, MetaImage), DICOM SEG, RTSTRUCT, or a folder with one file per mask.
    names : mapping of str to str
        {label: name}, which replace the names in the file.
    rois : sequence of str, optional
        Labels or names of the regions to read; by default all.
    fill_gaps : bool, optional
        Interpolate missing slices between two drawn slices.

    Returns
    -------
    list of Region
        Regions in the order of the file.

    Raises
    ------
    InputError
        For a file or a region of `rois` that cannot be read, and a file without regions. Also for an unknown label or
        an invalid name in `names`, and for two regions with the same name.
    """
    labels = Path(labels)
    broken: dict[str, str] = {}
    found = _find_regions(labels, image.grid, fill_gaps, broken)
    new_names = _names(labels, found, names, broken)
    selected = _selected(labels, found, new_names, rois, broken)
    regions, empty, remarks = [], [], []
    for done, (source, name) in enumerate(selected):
        progress("reading regions", done, len(selected))
        try:
            cropped = source.crop()
        except InputError as error:
            if rois:
                raise
            broken[source.original_name] = str(error)
            continue
        if cropped is None:
            empty.append(source.original_name)
            continue
        remarks += [(source.path, remark) for remark in cropped.remarks]
        regions.append(_region(image, cropped, name, str(source.path), source.label))
    if rois and empty:
        raise InputError(f"--rois: {labels}: {empty[0]} has no voxels; draw it, or remove it from --rois")
    for path in dict.fromkeys(path for path, _ in remarks):
        report(path, [remark for remark_path, remark in remarks if remark_path == path])
    if not rois:
        _report_skipped(labels, broken)
    if empty:
        note(f"{labels}: {counted(len(empty), 'region')} without voxels skipped: {', '.join(empty)}")
    if not regions:
        if broken:
            reason = next(iter(broken.values()))
            raise InputError(reason if len(broken) == 1 else f"{labels}: no region can be read; the first: {reason}")
        raise InputError(f"{labels}: has no regions; draw regions on the CT")
    return regions


def _find_regions(labels: Path, grid: Grid, fill_gaps: bool, broken: dict[str, str]) -> list[_FoundRegion]:
    """Return all regions. Masks of a folder that cannot be read go to `broken`, with the reason."""
    folder = labels.is_dir()
    paths = _files(labels)
    regions: list[_FoundRegion] = []
    for done, path in enumerate(paths):
        progress("opening masks", done, len(paths))
        try:
            reader = open_regions(path, grid)
            labels_of_file = reader.list_regions()
        except InputError as error:
            if not folder:
                raise
            broken[_stem(path)] = str(error)
            continue
        if folder and not labels_of_file:
            regions.append(_FoundRegion(path, None, _stem(path), (_stem(path),), lambda: None))
        for label, label_name in labels_of_file.items():
            single = folder and len(labels_of_file) == 1 and label_name is None
            name = _stem(path) if single else label_name or f"label_{label}"
            stem = [_stem(path)] if single else []
            aliases = tuple(dict.fromkeys((str(label), *reader.aliases(label), name, *stem)))
            if folder:  # read each mask now, so that its file need not stay in memory
                try:
                    cropped = reader.crop(label, fill_gaps)
                except InputError as error:
                    broken[name] = str(error)
                    continue
                region = _FoundRegion(path, None if single else label, name, aliases, lambda cropped=cropped: cropped)
                twin = next((other for other in regions if single and _same_mask(other, region)), None)
                if twin is None:
                    regions.append(region)
                else:
                    note(f"{path}: is the same mask as {twin.path}; it is skipped")
            else:
                crop = partial(reader.crop, label, fill_gaps)
                regions.append(_FoundRegion(path, label, name, aliases, crop))
    return regions


def _same_mask(first: _FoundRegion, second: _FoundRegion) -> bool:
    """Return whether two masks of a folder are equal and their file names differ only in case or suffix."""
    same_name = first.original_name.lower() == second.original_name.lower()
    if first.label is not None or second.label is not None or not same_name:
        return False
    mask, other = first.crop(), second.crop()
    if mask is None or other is None:
        return mask is other
    return mask.box == other.box and np.array_equal(mask.mask, other.mask)


def _selected(
    labels: Path, found: Sequence[_FoundRegion], names: Sequence[str], rois: Sequence[str], broken: Mapping[str, str]
) -> list[tuple[_FoundRegion, str]]:
    """Return (region, name) for the regions named in `rois`, or for all regions."""
    pairs = list(zip(found, names, strict=True))
    for roi in rois:
        if any(roi in (*region.aliases, name) for region, name in pairs):
            continue
        reason = next((text for name, text in broken.items() if roi in (name, _base(name))), None)
        if reason is not None:
            raise InputError(reason)
        raise InputError(f"--rois: {labels} has no region '{roi}'; {did_you_mean(roi, names, 'there are')}")
    return [(region, name) for region, name in pairs if not rois or set(rois) & {*region.aliases, name}]


def _report_skipped(labels: Path, broken: Mapping[str, str]) -> None:
    """Print a note for each skipped region; many regions with the same reason share one note."""
    alike: dict[str, list[str]] = {}
    for name, reason in broken.items():
        alike.setdefault(re.sub(r"[-+\d.]+", "#", reason.replace(name, "@")), []).append(name)
    for names in alike.values():
        shown = names if len(names) <= ONE_BY_ONE else names[:1]
        for name in shown:
            note(f"{name} is skipped: {broken[name]}")
        if more := names[len(shown) :]:
            note(f"{labels}: {len(more)} more regions are skipped for the same reason as {names[0]}: {', '.join(more)}")


def _files(labels: Path) -> list[Path]:
    """Return the file itself, or the mask files of a folder."""
    if not labels.is_dir():
        return [labels]
    files = sorted(path for path in labels.iterdir() if path.is_file() and not path.name.startswith("."))
    headers = {path.stem.lower() for path in files if path.suffix.lower() == ".hdr"}
    masks = [path for path in files if suffix_of(path)]
    masks = [
        path for path in masks if path.suffix.lower() != ".img" or path.with_suffix("").name.lower() not in headers
    ]
    if not masks:
        masks = [path for path in files if _is_dicom_segmentation(path)]
    if not masks:
        raise InputError(
            f"{labels}: has no mask (NIfTI, NRRD, MetaImage), DICOM SEG or RTSTRUCT; give a file with regions or a "
            "folder of masks"
        )
    others = [path.name for path in files if path not in masks and path.suffix.lower() not in (".img", ".raw", ".json")]
    if others:
        names = ", ".join(others[:ONE_BY_ONE]) + (", ..." if len(others) > ONE_BY_ONE else "")
        note(f"{labels}: {counted(len(others), 'file')} without masks skipped: {names}")
    return masks


def _is_dicom_segmentation(path: Path) -> bool:
    """Return whether a file is a DICOM SEG or RTSTRUCT."""
    try:
        header = None if not_dicom(path) else read_header(path)
    except InputError:
        return False
    return header is not None and header.values.get("SOPClassUID") in {(uid,) for uid in KINDS}


def _stem(path: Path) -> str:
    """Return the name of a file without the suffix of its format and without Slicer's ".seg"."""
    suffix = suffix_of(path)
    name = path.name[: -len(suffix)] if suffix else path.stem
    return name[:-4] if name.lower().endswith(".seg") else name


def _names(
    labels: Path, found: Sequence[_FoundRegion], names: Mapping[str, str], broken: Mapping[str, str]
) -> list[str]:
    """Return unique names that are valid in files and tables. Changed names are reported."""
    unused = dict(names)
    given, bases = [], []
    for region in found:
        name = next((unused.pop(alias) for alias in region.aliases if alias in unused), None)
        if name is not None and not re.fullmatch(rf"[A-Za-z0-9_]{{1,{LONGEST_NAME}}}", name):
            raise InputError(f"--names: '{name}' must be of letters, digits and underscores, {LONGEST_NAME} at most")
        given.append(name is not None)
        bases.append(name if name is not None else _base(region.original_name))
    if unknown := [label for label in unused if label not in broken]:
        known = ", ".join(str(region.original_name if region.label is None else region.label) for region in found)
        raise InputError(f"--names: {labels} has no region '{unknown[0]}'; there are: {known}")
    if doubled := [n for n, count in Counter(n for n, g in zip(bases, given, strict=True) if g).items() if count > 1]:
        raise InputError(f"{labels}: two regions have the name {doubled[0]}; rename one by --names LABEL=NAME")
    counts = Counter(base.lower() for base in bases)
    taken = {base.lower() for base, user in zip(bases, given, strict=True) if user or counts[base.lower()] == 1}
    unique = []
    for position, (region, base, user) in enumerate(zip(found, bases, given, strict=True), 1):
        name = base
        if not user and (counts[base.lower()] > 1 or not base):
            name = _numbered(base or "region", _number(region, position), taken)
        taken.add(name.lower())
        unique.append(name)
    _report_renamed(labels, found, bases, unique)
    return unique


def _number(region: _FoundRegion, position: int) -> int:
    """Return the number of a region in its file, or else its position among all regions."""
    return next((int(alias) for alias in region.aliases if alias.isascii() and alias.isdigit()), position)


def _numbered(base: str, number: int, taken: set[str]) -> str:
    while True:
        name = f"{base[: LONGEST_NAME - len(str(number)) - 1]}_{number}"
        if name.lower() not in taken:
            return name
        number += 1


def _report_renamed(labels: Path, found: Sequence[_FoundRegion], bases: Sequence[str], names: Sequence[str]) -> None:
    alike: dict[str, list[str]] = {}
    for region, base, name in zip(found, bases, names, strict=True):
        if base != name:
            alike.setdefault(base, []).append(f"'{region.original_name}' is called {name}")
    for base, lines in alike.items():
        why = f"several regions have the name {base}" if base else "names need ASCII letters"
        note(f"{labels}: {why}: {', '.join(lines)}; use --names LABEL=NAME for other names")


def _base(original_name: str) -> str:
    """Return a name of ASCII letters, digits and underscores; "" if another script leaves too little of it."""
    decomposed = unicodedata.normalize("NFKD", original_name.casefold().translate(LETTERS))
    bare = "".join(c for c in decomposed if not unicodedata.combining(c))
    name = re.sub(r"[^a-z0-9]+", "_", bare).strip("_")[:LONGEST_NAME].rstrip("_")
    lost = any(c.isalnum() and not c.isascii() for c in bare)
    return "" if lost and all(ONE_OF_SEVERAL.match(word) for word in name.split("_") if word) else name


def tissue_class(name: str) -> str:
    """Return the name of a region without words for side and number: muscle for muscle_left."""
    words = [word for word in name.split("_") if not ONE_OF_SEVERAL.match(word)]
    return name if not words or (len(words) == 1 and words[0] in NAMELESS) else "_".join(words)


def _region(image: Volume, cropped: CroppedRegion, name: str, file: str, label: int | str | None) -> Region:
    values = image.array[cropped.box][cropped.mask].astype(np.float64)
    return Region(
        name=name,
        tissue_class=tissue_class(name),
        file=file,
        label=label,
        box=cropped.box,
        mask=cropped.mask,
        volume_ml=values.size * image.grid.voxel_volume_mm3 / 1000,
        mean_hu=float(values.mean()),
        sd_hu=float(values.std()),
        gas_share=float((values < GAS_HU).mean()),
        grid=image.grid,
    )
