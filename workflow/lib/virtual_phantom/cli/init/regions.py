"""The regions that are drawn on a CT, each with its size, CT numbers and place."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...base.console import note, progress
from ...base.errors import InputError, meant
from ...base.geometry import Grid
from ...base.words import counted
from ...io.volumes import Volume, suffix_of
from ...phantom.dicom_files import not_dicom, read_header
from ...phantom.masks import KINDS, open_regions
from ...phantom.regions import ONE_BY_ONE, Drawn, report

GAS_HU = -300.0  # less dense than fat (-100) by more than noise: gas, or lung
LONGEST_NAME = 56  # of a region; with the number of a part 64, as the schema allows
# Words of a name that say which one of several of a tissue it is: a side, a number, a vertebra or a rib.
ONE_OF_SEVERAL = re.compile(r"^(left|right|l|r|\d+|[ctls]\d+)$", re.IGNORECASE)
NAMELESS = ("label", "region", "roi")  # names that say nothing of the tissue without their number
# Latin letters that Unicode does not decompose into a letter of ASCII and an accent.
LETTERS = str.maketrans(
    {"ø": "o", "ł": "l", "đ": "d", "ð": "d", "þ": "th", "æ": "ae", "œ": "oe", "ı": "i", "µ": "u", "μ": "u"}
)


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


@dataclass(frozen=True)
class _Found:
    """A region of a file before its voxels are needed."""

    path: Path
    label: int | str | None
    own: str  # the name that the file or its own name gives it
    known: tuple[str, ...]  # what a user may call it
    draw: Callable[[], Drawn | None]


def read_regions(
    image: Volume,
    labels: str | Path,
    names: Mapping[str, str],
    rois: Sequence[str] = (),
    fill_gaps: bool = False,
) -> list[Region]:
    """Regions of a file, or of a folder of masks.

    Without `rois`, regions that cannot be read or are empty are reported and left out.

    Parameters
    ----------
    image : Volume
        The CT, HU.
    labels : str or Path
        Label map or mask (NIfTI, NRRD, MetaImage), DICOM SEG, RTSTRUCT, or a folder of masks with a file each.
    names : mapping of str to str
        {label: name} that replace the file's own.
    rois : sequence of str, optional
        Labels or names of the only regions to read.
    fill_gaps : bool, optional
        Interpolate slices that are not drawn, between two that are.

    Returns
    -------
    list of Region
        In the order of the file.

    Raises
    ------
    InputError
        For a file or a region of `rois` that cannot be read, a name of `names` for a label that is not there or that is
        not of letters, digits and underscores, a name given twice, and where there is no region at all.
    """
    labels = Path(labels)
    broken: dict[str, str] = {}
    there = _there(labels, image.grid, fill_gaps, broken)
    called = _called(labels, there, names, broken)
    wanted = _wanted(labels, there, called, rois, broken)
    regions, empty, remarks = [], [], []
    for done, (found, name) in enumerate(wanted):
        progress("reading regions", done, len(wanted))
        try:
            drawn = found.draw()
        except InputError as error:
            if rois:
                raise
            broken[found.own] = str(error)
            continue
        if drawn is None:
            empty.append(found.own)
            continue
        remarks += [(found.path, one) for one in drawn.remarks]
        regions.append(_region(image, drawn, name, str(found.path), found.label))
    if rois and empty:
        raise InputError(f"--rois: {labels}: {empty[0]} has no voxel; draw it, or take it out")
    for path in dict.fromkeys(path for path, _ in remarks):
        report(path, [one for source, one in remarks if source == path])
    if not rois:
        _report_left_out(labels, broken)
    if empty:
        note(f"{labels}: {counted(len(empty), 'region')} without voxels passed over: {', '.join(empty)}")
    if not regions:
        if broken:
            reason = next(iter(broken.values()))
            raise InputError(reason if len(broken) == 1 else f"{labels}: no region can be read; the first: {reason}")
        raise InputError(f"{labels}: holds no region; draw some on the CT")
    return regions


def _there(labels: Path, grid: Grid, fill_gaps: bool, broken: dict[str, str]) -> list[_Found]:
    """Every region; masks of a folder that cannot be read go to `broken`, with the reason."""
    folder = labels.is_dir()
    paths = _files(labels)
    there: list[_Found] = []
    for done, path in enumerate(paths):
        progress("opening masks", done, len(paths))
        try:
            reader = open_regions(path, grid)
            listed = reader.there()
        except InputError as error:
            if not folder:
                raise
            broken[_stem(path)] = str(error)
            continue
        if folder and not listed:
            there.append(_Found(path, None, _stem(path), (_stem(path),), lambda: None))
        for label, named in listed.items():
            alone = folder and len(listed) == 1 and named is None
            own = _stem(path) if alone else named or f"label_{label}"
            known = tuple(dict.fromkeys((str(label), *reader.aliases(label), own, *([_stem(path)] if alone else []))))
            if folder:  # one mask at a time: the file need not be kept
                try:
                    drawn = reader.crop(label, fill_gaps)
                except InputError as error:
                    broken[own] = str(error)
                    continue
                found = _Found(path, None if alone else label, own, known, lambda drawn=drawn: drawn)
                twin = next((one for one in there if alone and _are_twins(one, found)), None)
                if twin is None:
                    there.append(found)
                else:
                    note(f"{path}: is the same mask as {twin.path}; it is passed over")
            else:
                there.append(
                    _Found(path, label, own, known, lambda one=label, reader=reader: reader.crop(one, fill_gaps))
                )
    return there


def _are_twins(one: _Found, other: _Found) -> bool:
    """Whether two masks of a folder are equal, and their file names but for case and suffix."""
    if one.label is not None or other.label is not None or one.own.lower() != other.own.lower():
        return False
    first, second = one.draw(), other.draw()
    if first is None or second is None:
        return first is second
    return first.box == second.box and np.array_equal(first.mask, second.mask)


def _wanted(
    labels: Path, there: Sequence[_Found], called: Sequence[str], rois: Sequence[str], broken: Mapping[str, str]
) -> list[tuple[_Found, str]]:
    """Regions and their names, of those that `rois` asks for."""
    pairs = list(zip(there, called, strict=True))
    for one in rois:
        if any(one in (*found.known, name) for found, name in pairs):
            continue
        reason = next((text for own, text in broken.items() if one in (own, _base(own))), None)
        if reason is not None:
            raise InputError(reason)
        raise InputError(f"--rois: {labels} has no region '{one}'; {meant(one, called, 'there are')}")
    return [(found, name) for found, name in pairs if not rois or set(rois) & {*found.known, name}]


def _report_left_out(labels: Path, broken: Mapping[str, str]) -> None:
    """A line for each region that is left out; many for one reason become one line that names all of them."""
    alike: dict[str, list[str]] = {}
    for own, reason in broken.items():
        alike.setdefault(re.sub(r"[-+\d.]+", "#", reason.replace(own, "@")), []).append(own)
    for names in alike.values():
        shown = names if len(names) <= ONE_BY_ONE else names[:1]
        for own in shown:
            note(f"{own} is left out: {broken[own]}")
        if more := names[len(shown) :]:
            note(
                f"{labels}: {len(more)} more regions are left out for the same reason as {names[0]}: {', '.join(more)}"
            )


def _files(labels: Path) -> list[Path]:
    """The file, or the masks of a folder."""
    if not labels.is_dir():
        return [labels]
    seen = sorted(path for path in labels.iterdir() if path.is_file() and not path.name.startswith("."))
    heads = {path.with_suffix("").name.lower() for path in seen if path.suffix.lower() == ".hdr"}
    masks = [path for path in seen if suffix_of(path)]
    masks = [one for one in masks if one.suffix.lower() != ".img" or one.with_suffix("").name.lower() not in heads]
    if not masks:
        masks = [path for path in seen if _is_drawn(path)]
    if not masks:
        raise InputError(
            f"{labels}: holds no mask (NIfTI, NRRD, MetaImage), DICOM SEG or RTSTRUCT; give a file of regions or a "
            "folder of masks"
        )
    others = [path.name for path in seen if path not in masks and path.suffix.lower() not in (".img", ".raw", ".json")]
    if others:
        some = ", ".join(others[:ONE_BY_ONE]) + (", ..." if len(others) > ONE_BY_ONE else "")
        note(f"{labels}: {counted(len(others), 'file')} passed over, no masks: {some}")
    return masks


def _is_drawn(path: Path) -> bool:
    """Whether a file is a DICOM SEG or RTSTRUCT."""
    try:
        header = None if not_dicom(path) else read_header(path)
    except InputError:
        return False
    return header is not None and header.values.get("SOPClassUID") in {(uid,) for uid in KINDS}


def _stem(path: Path) -> str:
    """Name of a file without the suffix of its format, and without Slicer's ".seg"."""
    suffix = suffix_of(path)
    name = path.name[: -len(suffix)] if suffix else path.stem
    return name[:-4] if name.lower().endswith(".seg") else name


def _called(labels: Path, there: Sequence[_Found], names: Mapping[str, str], broken: Mapping[str, str]) -> list[str]:
    """Names that files and tables can have, each once; what the files' own names are replaced by is reported."""
    unused = dict(names)
    given, bases = [], []
    for found in there:
        name = next((unused.pop(one) for one in found.known if one in unused), None)
        if name is not None and not re.fullmatch(rf"[A-Za-z0-9_]{{1,{LONGEST_NAME}}}", name):
            raise InputError(f"--names: '{name}' must be of letters, digits and underscores, {LONGEST_NAME} at most")
        given.append(name is not None)
        bases.append(name if name is not None else _base(found.own))
    if unknown := [one for one in unused if one not in broken]:
        known = ", ".join(str(found.label if found.label is not None else found.own) for found in there)
        raise InputError(f"--names: {labels} has no region '{unknown[0]}'; there are: {known}")
    if doubled := [n for n, count in Counter(n for n, g in zip(bases, given, strict=True) if g).items() if count > 1]:
        raise InputError(f"{labels}: two regions would be called {doubled[0]}; tell them apart by --names LABEL=NAME")
    several = Counter(base.lower() for base in bases)
    taken = {base.lower() for base, one in zip(bases, given, strict=True) if one or several[base.lower()] == 1}
    called = []
    for position, (found, base, one) in enumerate(zip(there, bases, given, strict=True), 1):
        name = base
        if not one and (several[base.lower()] > 1 or not base):
            name = _numbered(base or "region", _number(found, position), taken)
        taken.add(name.lower())
        called.append(name)
    _report_renamed(labels, there, bases, called)
    return called


def _number(found: _Found, position: int) -> int:
    """The number of a region in its file, else its position among all regions."""
    return next((int(one) for one in found.known if one.isascii() and one.isdigit()), position)


def _numbered(base: str, number: int, taken: set[str]) -> str:
    while True:
        name = f"{base[: LONGEST_NAME - len(str(number)) - 1]}_{number}"
        if name.lower() not in taken:
            return name
        number += 1


def _report_renamed(labels: Path, there: Sequence[_Found], bases: Sequence[str], called: Sequence[str]) -> None:
    alike: dict[str, list[str]] = {}
    for found, base, name in zip(there, bases, called, strict=True):
        if base != name:
            alike.setdefault(base, []).append(f"'{found.own}' is called {name}")
    for base, lines in alike.items():
        why = f"several regions would be called {base}" if base else "names need letters of ASCII"
        note(f"{labels}: {why}: {', '.join(lines)}; --names LABEL=NAME gives other names")


def _base(own: str) -> str:
    """A name of letters of ASCII, digits and underscores; empty if too little is left of a name in another script."""
    decomposed = unicodedata.normalize("NFKD", own.casefold().translate(LETTERS))
    bare = "".join(c for c in decomposed if not unicodedata.combining(c))
    name = re.sub(r"[^a-z0-9]+", "_", bare).strip("_")[:LONGEST_NAME].rstrip("_")
    lost = any(c.isalnum() and not c.isascii() for c in bare)
    return "" if lost and all(ONE_OF_SEVERAL.match(word) for word in name.split("_") if word) else name


def tissue_class(name: str) -> str:
    """The name of a region without the words that say which one of several it is: muscle of muscle_left."""
    words = [word for word in name.split("_") if not ONE_OF_SEVERAL.match(word)]
    return name if not words or (len(words) == 1 and words[0] in NAMELESS) else "_".join(words)


def _region(image: Volume, drawn: Drawn, name: str, file: str, label: int | str | None) -> Region:
    values = image.array[drawn.box][drawn.mask].astype(np.float64)
    return Region(
        name=name,
        tissue_class=tissue_class(name),
        file=file,
        label=label,
        box=drawn.box,
        mask=drawn.mask,
        volume_ml=values.size * image.grid.voxel_volume_mm3 / 1000,
        mean_hu=float(values.mean()),
        sd_hu=float(values.std()),
        gas_share=float((values < GAS_HU).mean()),
        grid=image.grid,
    )
