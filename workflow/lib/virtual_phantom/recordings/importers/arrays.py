"""Reading of arrays from image stacks (TIFF, PNG), NumPy, MATLAB and HDF5 files (Data Exchange, NeXus NXtomo)."""

from __future__ import annotations

import itertools
import os
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import tifffile
from PIL import Image
from scipy.io import loadmat, whosmat

from ...base.console import note
from ...base.errors import InputError, reading
from ...base.names import enumerated
from ...io.files import files_of
from ..projections import theta_degrees

TIFF, IMAGES = (".tif", ".tiff"), (".tif", ".tiff", ".png", ".bmp")
HDF5 = (".h5", ".hdf5", ".hdf", ".nxs")
FORMATS = (*IMAGES, ".npy", ".npz", ".mat", *HDF5)
FIELDS = ("data_white", "data_dark")  # names of the Data Exchange format for frames without an object or without X-rays
# Values of image_key of NXtomo (NeXus application definition): projection, flat field, dark field; 3 is invalid.
PROJECTION, FLAT, DARK = 0, 1, 2
MATLAB_NUMBERS = ("double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
MOST_NAMES = 8  # datasets listed in a message


@dataclass(frozen=True)
class Frames:
    """Frames of a file, and what the file states beside them; None where it states nothing.

    Attributes
    ----------
    data : ndarray or None
        Axes as stored. None: the file has fields alone.
    flat, dark : ndarray or None
        Frames without an object and without X-rays.
    angles_deg : ndarray, shape (views,), or None
    log : bool
        Whether the file says that its values are line integrals.
    """

    data: np.ndarray | None
    flat: np.ndarray | None = None
    dark: np.ndarray | None = None
    angles_deg: np.ndarray | None = None
    log: bool = False


def read_frames(source: str | Path, dataset: str | None = None, others: Collection[str | Path] = ()) -> Frames:
    """Read the frames of a file, or of a folder with one image per view.

    Parameters
    ----------
    dataset : str, optional
        Variable of a MATLAB or .npz file, or path in an HDF5 file. Default: the only array, or the largest one in HDF5.
    others : collection of str or Path, optional
        Files in the folder that are not views, such as the flat field.

    Raises
    ------
    InputError
        If the file is missing, damaged or of an unknown format, has several arrays or color images, or if the images
        of a folder are not of one series. Also if an array does not contain numbers, or `dataset` is given for a file
        without named arrays.
    """
    frames = _read(source, dataset, others)
    for array in (frames.data, frames.flat, frames.dark):
        if array is not None:
            _check_numbers(array, source)
    return frames


def _check_numbers(array: object, source: str | Path) -> None:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "uif":  # MATLAB arrays may be sparse
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise InputError(f"{source}: holds values of type {kind}; give an array of numbers")


def _read(source: str | Path, dataset: str | None, others: Collection[str | Path]) -> Frames:
    if not str(source):
        raise InputError("the path of an array is empty; give a file or folder (a shell variable may be unset)")
    path = Path(source)
    if not os.path.exists(path):  # unlike Path.exists, False for names that are too long
        raise InputError(f"{path}: no such file or folder; correct the path")
    suffix = path.suffix.lower()
    if dataset is not None and (path.is_dir() or suffix in (*IMAGES, ".npy")):
        raise InputError(f"{path}: has no named arrays, so --dataset {dataset} has no effect; remove it")
    if path.is_dir():
        return Frames(_stack(path, others))
    if suffix in IMAGES:
        return Frames(_image(path))
    if suffix == ".npy":
        with reading(path, "NumPy array"):
            return Frames(np.load(path, allow_pickle=False))
    if suffix == ".npz":
        with reading(path, "NumPy archive"), np.load(path, allow_pickle=False) as file:
            return Frames(_chosen(path, {name: file[name] for name in file.files}, dataset))
    if suffix == ".mat":
        return Frames(_matlab(path, dataset))
    if suffix in HDF5:
        return _hdf5(path, dataset)
    raise InputError(
        f"{path}: has an unknown format; convert it to one of {' '.join(FORMATS)}, or give a folder of images"
    )


def _image(path: Path) -> np.ndarray:
    with reading(path, "image"):
        if path.suffix.lower() in TIFF:
            with tifffile.TiffFile(path) as file:
                color = "S" in file.series[0].axes  # samples per pixel
                pages = [series.asarray() for series in file.series]
        else:
            with Image.open(path) as image:
                # The values of a palette image (P) are indices of colors.
                color = "P" in image.mode or len(image.getbands()) > 1
                pages = [np.asarray(image)]
    if color:
        raise InputError(f"{path}: is a color image; use gray images")
    kinds = sorted({(page.shape, str(page.dtype)) for page in pages})
    if len(kinds) > 1:
        listed = enumerated([f"{kind} {shape}" for shape, kind in kinds])
        raise InputError(f"{path}: has pages of different types or shapes ({listed}); keep only the projections")
    # Programs that write page by page make each page a separate series.
    return pages[0] if len(pages) == 1 else np.stack(pages)


def _stack(folder: Path, others: Collection[str | Path] = ()) -> np.ndarray:
    """Return the images of a folder, shape (views, rows, columns), in the order of the numbers in their names."""
    excluded = {Path(name).resolve() for name in others}
    images = (path for path in files_of(folder) if path.suffix.lower() in IMAGES and path.resolve() not in excluded)
    files = sorted(images, key=lambda path: (_number_key(path), path.name))
    if not files:
        raise InputError(f"{folder}: has no images ({' '.join(IMAGES)}); give the folder with the projections")
    _check_names(files)
    first = _image(files[0])
    if first.ndim != 2:
        raise InputError(f"{files[0]}: has shape {first.shape}; use gray images, one per view")
    stack = np.empty((len(files), *first.shape), first.dtype)
    for index, path in enumerate(files):
        image = _image(path)
        if (image.shape, image.dtype) != (first.shape, first.dtype):
            raise InputError(
                f"{path}: has shape {image.shape} and type {image.dtype}, but {files[0].name} has {first.shape} and "
                f"{first.dtype}; keep only the projections in this folder"
            )
        stack[index] = image
    return stack


def _number_key(path: Path) -> list[int | str]:
    return [int(part) if index % 2 else part for index, part in enumerate(re.split("([0-9]+)", path.stem))]


def _check_names(files: Sequence[Path]) -> None:
    """Check that the names of sorted files differ in numbers only, and report a gap in these numbers.

    Raises
    ------
    InputError
        If a name differs otherwise, or two have the same numbers, as exports in two formats have. Also for decimals
        with different numbers of digits, such as 0.25 and 0.5, whose order is not clear. A final zero shows that the
        digits after the point are a counter: 1.10 follows 1.9.
    """
    patterns = Counter(re.sub("[0-9]+", "#", path.stem) for path in files)
    usual = patterns.most_common(1)[0][0]
    for path in files:
        if re.sub("[0-9]+", "#", path.stem) != usual:
            raise InputError(
                f"{path}: its name differs from {usual} (#: a number) of the others; keep only the projections in this "
                "folder, or give this file as --flat or --dark"
            )
    for path, following in itertools.pairwise(files):
        if _number_key(path) == _number_key(following):
            raise InputError(
                f"{following}: has the same number as {path.name}; keep only one image of each view in this folder"
            )
    decimals = [re.findall(r"(?<![0-9.])[0-9]+\.([0-9]+)(?!\.?[0-9])", path.stem) for path in files]
    for place in zip(*decimals, strict=True):
        counted = any(len(digits) > 1 and digits.endswith("0") for digits in place)
        if len({*map(len, place)}) > 1 and len({*map(int, place)}) > 1 and not counted:
            short, *_, long = sorted(zip(map(len, place), files, strict=True))
            raise InputError(
                f"{files[0].parent}: names of images have decimal numbers with different numbers of digits, such as "
                f"{short[1].name} and {long[1].name}, so that their order is not clear; number the images 0001, 0002, "
                "..."
            )
    numbers = np.array([_number_key(path)[1::2] for path in files], float)
    varying = numbers[:, np.ptp(numbers, axis=0) > 0] if numbers.size else numbers
    if varying.shape[1:] == (1,) and len(steps := np.diff(varying[:, 0])) > 1:
        uneven = np.flatnonzero(steps != np.median(steps))
        if uneven.size:
            before, after = files[uneven[0]], files[uneven[0] + 1]
            note(f"{before}: the next image is {after.name}; if a view is missing between, list the angles in a file")


def _matlab(path: Path, dataset: str | None) -> np.ndarray:
    if h5py.is_hdf5(path):  # version 7.3, whose arrays HDF5 shows with reversed axes
        with reading(path, "MATLAB 7.3"), h5py.File(path, "r") as file:
            arrays = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
            return np.asarray(_chosen(path, arrays, dataset)[...]).T
    with reading(path, "MATLAB"):
        listed = whosmat(path)
        shapes = {name: shape for name, shape, kind in listed if kind in MATLAB_NUMBERS}
        name = _chosen_name(path, [name for name, _, _ in listed], shapes, dataset)
        return loadmat(path, variable_names=[name])[name]


def _chosen(path: Path, arrays: Mapping, dataset: str | None):
    """Return an array by its name (`_chosen_name`)."""
    shapes = {name: value.shape for name, value in arrays.items() if _numeric(value)}
    return arrays[_chosen_name(path, list(arrays), shapes, dataset)]


def _chosen_name(path: Path, names: Sequence[str], shapes: Mapping[str, tuple[int, ...]], dataset: str | None) -> str:
    """Return the given name, or that of the only array with at least two dimensions, or of the only list."""
    if dataset is not None:
        if dataset not in names:
            raise InputError(f"{path}: has no dataset {dataset}; it has {_listed(names)}")
        return dataset
    wide = [name for name, shape in shapes.items() if len(shape) > 1 and min(shape) > 1]
    suitable = wide or [name for name, shape in shapes.items() if max(shape, default=1) > 1]
    if not suitable:
        raise InputError(
            f"{path}: has no array of numbers; it has {_listed(names)}; give the file with the measured data"
        )
    if len(suitable) > 1:
        raise InputError(
            f"{path}: has {len(suitable)} arrays ({_listed(suitable)}); name one with --dataset (write fields and "
            "angles to files of their own)"
        )
    return suitable[0]


def _numeric(value) -> bool:
    return getattr(getattr(value, "dtype", None), "kind", "") in "uif" and bool(value.shape)


def _listed(names: Sequence[str]) -> str:
    return enumerated([*names[:MOST_NAMES], *["others"] * (len(names) > MOST_NAMES)]) or "none"


def _hdf5(path: Path, dataset: str | None) -> Frames:
    with reading(path, "HDF5"), h5py.File(path, "r") as file:
        found: dict[str, h5py.Dataset] = {}
        file.visititems(lambda name, item: found.update({name: item} if isinstance(item, h5py.Dataset) else {}))
        if dataset is not None:
            chosen = file.get(dataset.strip("/") or "/")  # also a link, which visititems does not follow
            data = chosen if isinstance(chosen, h5py.Dataset) else _chosen(path, found, dataset)
        else:
            arrays = {name: item for name, item in found.items() if _numeric(item)}
            fields = {name: item for name, item in arrays.items() if name.rpartition("/")[2] in FIELDS}
            if fields and len(fields) == len(arrays):  # a file of fields alone
                return Frames(None, *_fields(next(iter(fields.values())).parent))
            arrays = {name: item for name, item in arrays.items() if name not in fields}
            whole = [item for item in arrays.values() if item.ndim == max(item.ndim for item in arrays.values())]
            largest = [item for item in whole if item.size == max(item.size for item in whole)]
            shapes = {name: item.shape for name, item in arrays.items() if item in largest}
            data = found[_chosen_name(path, list(found), shapes, None)]
        beside = {name.rpartition("/")[2]: item for name, item in found.items()}
        angles = next(
            (theta_degrees(path, beside[name]) for name in ("theta", "rotation_angle") if name in beside), None
        )
        flat, dark = _fields(data.parent)
        keys, values = beside.get("image_key"), data[...]
        if keys is not None and keys.shape == (len(values),):
            key = keys[...]
            angles = angles[key == PROJECTION] if angles is not None and angles.shape == key.shape else angles
            flat, dark = (values[key == kind] if (key == kind).any() else None for kind in (FLAT, DARK))
            values = values[key == PROJECTION]
        return Frames(values, flat, dark, angles, str(data.attrs.get("log", "")).lower() in ("true", "1"))


def _fields(group: h5py.Group) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return flat and dark frames of a group; None for missing ones."""
    found = (group.get(name) for name in FIELDS)
    flat, dark = (item[...] if isinstance(item, h5py.Dataset) and item.size else None for item in found)
    return flat, dark
