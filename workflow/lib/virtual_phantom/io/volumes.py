"""Volumes on a Grid, and their files: NIfTI, and NRRD and MetaImage through SimpleITK."""

from __future__ import annotations

import contextlib
import gzip
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import nibabel
import numpy as np

from ..base.console import note
from ..base.errors import InputError, refusing
from ..base.geometry import Grid
from .files import check_unchanged, replacing

NIFTI = (".nii", ".nii.gz", ".hdr", ".img", ".hdr.gz", ".img.gz")
ITK = (".nrrd", ".nhdr", ".mha", ".mhd")  # read through SimpleITK
IMAGE_SUFFIXES = (".nii", ".nii.gz", ".hdr", ".nrrd", ".nhdr", ".mha", ".mhd")  # for messages
LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])  # from the world frame of DICOM and ITK to that of NIfTI
SMALLEST_VOXEL_MM3 = 1e-9
CHUNK = 1 << 20  # bytes
GZIP = b"\x1f\x8b"  # the first bytes of a gzip file (RFC 1952)
GZIP_MOST = 1032  # largest expansion of a byte of deflate: 258 bytes from 2 bits (RFC 1951)
# Voxels by which a tilted axis may move a voxel center. Up to half a voxel, resampling to the upright grid by nearest
# neighbor returns the array unchanged. A rotation of 0.3 degrees moves the ends of 190 voxels by as much.
LARGEST_TILT = 0.5
# Degrees by which a whole volume may be rotated against the scanner's axes, as by a couch: the tolerance of couch
# angles (AAPM TG-142; Klein et al., Med. Phys. 36, 4197, 2009). The volume itself is not distorted.
LARGEST_ROTATION = 1.0
ORTHOGONAL = 1e-4  # largest cosine between two axes of a volume that is rotated and not sheared: 10 um in 100 mm
SEEN_TILT = 0.05  # voxels; from here on the tilt is reported. Header values in single precision stay below 1e-3.


@dataclass(frozen=True)
class Volume:
    """An array, shape (z, y, x), and the grid of its voxels."""

    array: np.ndarray = field(repr=False)
    grid: Grid

    def __post_init__(self):
        if self.array.shape != self.grid.shape:
            raise ValueError(f"array of shape {self.array.shape} on a grid of shape {self.grid.shape}")


def suffix_of(path: str | Path) -> str | None:
    """Return the suffix of an image format, such as ".nii.gz", in lower case; None if there is none."""
    name = Path(path).name.lower()
    return max((suffix for suffix in (*NIFTI, *ITK) if name.endswith(suffix)), key=len, default=None)


def read_image(path: str | Path, dtype=np.float32, noted: bool = True) -> Volume:
    """Read a 3D image, its axes flipped and swapped to run along +x, +y, +z.

    Parameters
    ----------
    path : str or Path
        NIfTI (also as a pair of .hdr and .img), NRRD or MetaImage, by the suffix in upper or lower case.
    dtype : dtype or None, optional
        Data type of the result; None: the data type of the file.
    noted : bool, optional
        Report headers that have no orientation, two orientations, or a small tilt.

    Raises
    ------
    InputError
        If the file is missing, truncated, of another format, not 3D, or its axes are tilted against the scanner's.
    """
    array, affine = _voxels(Path(path), noted)
    return upright(array, affine, path, dtype, noted)


def read_layers(path: str | Path) -> tuple[list[Volume], dict[str, str]]:
    """Read a label image with the key/value pairs of its header, as 3D Slicer writes them in .seg.nrrd files.

    There is one layer per component of a voxel; Slicer writes several if segments overlap. The header is empty for
    NIfTI.

    Raises
    ------
    InputError
        For the errors of `read_image`.
    """
    path = Path(path)
    if suffix_of(path) not in ITK:
        return [read_image(path, None, noted=False)], {}
    image = _read_itk(path)
    header = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
    array, affine = _of_itk(image)
    layers = [array] if array.ndim == 3 else list(np.moveaxis(array, -1, 0))
    return [upright(layer, affine, path, None, noted=False) for layer in layers], header


def _voxels(path: Path, noted: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the array (x, y, z) and the affine from voxel index to RAS world mm."""
    if suffix_of(path) in ITK:
        image = _read_itk(path)
        if noted and "NRRD_space" not in image.GetMetaDataKeys() and suffix_of(path) in (".nrrd", ".nhdr"):
            note(f"{path}: its header has no 'space'; its axes are taken to run to the left, posterior and superior")
        return _of_itk(image)
    with _opened(path) as image:
        if noted:
            _report_orientation(image, path)
        return np.asarray(image.dataobj), image.affine


def _report_orientation(image: nibabel.Nifti1Image, path: Path) -> None:
    """Report a header without an orientation, or whose sform and qform differ by more than half a voxel."""
    sform, qform = image.get_sform(coded=True)[0], image.get_qform(coded=True)[0]
    if sform is None and qform is None:
        note(
            f"{path}: its header has no orientation (sform_code and qform_code are 0); its first axis is taken to run "
            "to the patient's left, the others to anterior and superior, around the origin"
        )
    elif sform is not None and qform is not None and np.isfinite(sform).all():
        ends = np.array(np.meshgrid(*[(0, n - 1) for n in image.shape[:3]])).reshape(3, -1)
        apart = np.abs(
            np.linalg.pinv(sform[:3, :3]) @ ((qform - sform) @ np.vstack([ends, np.ones(ends.shape[1])]))[:3]
        )
        if not apart.max() <= 0.5:
            note(
                f"{path}: sform and qform of its header put voxels up to {apart.max():.3g} voxels apart; sform is used"
            )


def _read_itk(path: Path):
    """Read an NRRD or MetaImage file; its size is checked before memory is allocated."""
    import SimpleITK as sitk  # takes 0.5 s to import and is not needed for NIfTI

    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of an image")
    apart = suffix_of(path) in (".mhd", ".nhdr")
    with refusing(
        f"{path}: cannot be read as {suffix_of(path)[1:].upper()}",
        RuntimeError,
        advice="is the file of voxels that it names there, and complete?" if apart else "is the file complete?",
        quoted=False,
    ):
        reader = sitk.ImageFileReader()
        reader.SetImageIO("NrrdImageIO" if suffix_of(path) in (".nrrd", ".nhdr") else "MetaImageIO")
        reader.SetFileName(str(path))
        reader.ReadImageInformation()
        voxels = math.prod(reader.GetSize()) * reader.GetNumberOfComponents()
        check_fits(4 * voxels, path)
        return reader.Execute()


def _of_itk(image) -> tuple[np.ndarray, np.ndarray]:
    """Return the array (x, y, z) or (x, y, z, component), and the affine from voxel index to RAS world mm."""
    import SimpleITK as sitk

    array = sitk.GetArrayFromImage(image)
    components = image.GetNumberOfComponentsPerPixel() > 1
    array = np.moveaxis(array, -1, 0).T if components else array.T  # (x, y, z, component)
    n = min(image.GetDimension(), 3)
    affine = np.eye(4)
    direction = np.reshape(image.GetDirection(), (image.GetDimension(),) * 2)[:n, :n]
    affine[:n, :n] = direction * np.array(image.GetSpacing())[:n]
    affine[:n, 3] = image.GetOrigin()[:n]
    return array, LPS_TO_RAS @ affine


def read_nifti(path: str | Path, dtype=np.float32) -> Volume:
    """Read a 3D NIfTI image like `read_image`, but refuse other formats.

    Raises
    ------
    InputError
        If the file is missing, truncated, not NIfTI, not 3D, or its axes are tilted against the scanner's.
    """
    with _opened(Path(path)) as image:
        array, affine = np.asarray(image.dataobj), image.affine
    return upright(array, affine, path, dtype)


def length_unit(path: str | Path) -> str:
    """Return the unit of lengths in an image header, as NiBabel names it. NRRD and MetaImage have none: "unknown".

    Raises
    ------
    InputError
        If the file is missing or has no NIfTI header.
    """
    if suffix_of(path) in ITK:
        return "unknown"
    with _opened(Path(path), whole=False) as image:
        return image.header.get_xyzt_units()[0]


def shape_of(path: str | Path) -> tuple[int, ...]:
    """Return the stored number of voxels along z, y and x, without reading them.

    Raises
    ------
    InputError
        If the file is missing or has no NIfTI header.
    """
    with _opened(Path(path), whole=False) as image:
        return image.shape[::-1]


@contextlib.contextmanager
def _opened(path: Path, whole: bool = True) -> Iterator[nibabel.Nifti1Image]:
    """Open a NIfTI-1 or NIfTI-2 image without reading its voxels.

    With `whole`, check that the file is unchanged and read it to its end: gzip's checksum is there, but nibabel stops
    at the last voxel.

    Raises
    ------
    InputError
        If the file is missing, changed, or cannot be read as NIfTI.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of a NIfTI image")
    if whole:
        check_unchanged(path)
    # nibabel raises many types of exceptions for broken files.
    with refusing(f"{path}: cannot be read as NIfTI", Exception, advice="is the file complete?"):
        if (suffix_of(path) or "").startswith((".hdr", ".img")):
            yield _pair(path)
            return
        with path.open("rb") as stream:
            packed = stream.read(2) == GZIP  # independent of the suffix
        with (gzip.open if packed else open)(path, "rb") as stream:
            image = _class_of(stream, path).from_stream(stream)
            _check_size(image, path, path.stat().st_size * (GZIP_MOST if packed else 1))
            yield image
            if not whole:
                return
            stream.seek(_end(image))
            surplus = 0
            while block := stream.read(CHUNK):
                surplus += len(block)
            if surplus:
                raise InputError(
                    f"{path}: has {surplus} bytes after the voxels that its header describes "
                    f"({_size(image)} of {image.header.get_data_dtype()} from byte {_end(image, 0)}); its header is "
                    "damaged: write the file again"
                )


def _pair(path: Path) -> nibabel.Nifti1Pair:
    """Return a NIfTI image in two files, given one of their names."""
    suffix = path.name[-len(suffix_of(path)) :]
    base, packed = path.name[: -len(suffix)], suffix[4:]
    upper = suffix[1].isupper()
    files = {}
    for part in ("hdr", "img"):
        files[part] = path.with_name(f"{base}.{part.upper() if upper else part}{packed}")
        if not files[part].is_file():
            raise InputError(f"{path}: {files[part].name} is missing; a header and its voxels belong in one folder")
    with (gzip.open if packed else open)(files["hdr"], "rb") as stream:
        header = stream.read(348)
    second = header[:4] in ((540).to_bytes(4, "little"), (540).to_bytes(4, "big"))
    if not second and header[344:347] != b"ni1":
        raise InputError(
            f"{path}: is Analyze 7.5, not NIfTI, and does not say which side is left; convert it to NIfTI or NRRD"
        )
    names = {"header": str(files["hdr"]), "image": str(files["img"])}
    kind = nibabel.Nifti2Pair if second else nibabel.Nifti1Pair
    image = kind.from_file_map(kind.make_file_map(names))
    most = files["img"].stat().st_size
    _check_size(image, path, most * (GZIP_MOST if packed else 1))
    if not packed and most > _end(image):
        raise InputError(
            f"{path}: {files['img'].name} has {most - _end(image)} bytes after the voxels that its header describes "
            f"({_size(image)} of {image.header.get_data_dtype()}); its header is damaged: write the file again"
        )
    return image


def _end(image: nibabel.Nifti1Image, voxels: int | None = None) -> int:
    """Return the byte at which the voxels of an image end; with `voxels` 0, where they begin."""
    count = math.prod(map(int, image.shape)) if voxels is None else voxels
    return int(image.dataobj.offset) + count * image.header.get_data_dtype().itemsize


def _size(image: nibabel.Nifti1Image) -> str:
    return f"{' x '.join(map(str, image.shape))} voxels"


def _class_of(stream: BinaryIO, path: Path) -> type:
    """Return NIfTI-1 or NIfTI-2 by the header size in the file, in either byte order."""
    start = stream.read(352)
    stream.seek(0)
    for kind, size in ((nibabel.Nifti1Image, 348), (nibabel.Nifti2Image, 540)):
        if start[:4] in (size.to_bytes(4, "little"), size.to_bytes(4, "big")):
            if kind is nibabel.Nifti1Image and start[344:348] not in (b"n+1\0", b"ni1\0"):
                raise InputError(
                    f"{path}: is not a NIfTI file: its header lacks the magic string 'n+1'; write it again as NIfTI"
                )
            return kind
    raise InputError(f"{path}: has no NIfTI header; is it another format, or damaged?")


def _check_size(image: nibabel.Nifti1Image, path: Path, most: int) -> None:
    """Refuse, before memory is allocated, a header that asks for more than the file or the memory can contain."""
    voxels = math.prod(map(int, image.shape))
    claimed = voxels * image.header.get_data_dtype().itemsize
    if min(image.shape, default=0) < 1 or claimed > most:
        raise InputError(
            f"{path}: its header says {_size(image)}, which the file does not contain; is the file complete?"
        )
    check_fits(max(claimed, 4 * voxels), path)


def check_fits(needed: int, source: str | Path) -> None:
    """Check that an array of `needed` bytes fits into the machine's memory; the message begins with `source`.

    Raises
    ------
    InputError
        If it does not fit.
    """
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there:
        raise InputError(
            f"{source}: needs {needed / 1e9:.3g} GB of memory, but the machine has {there / 1e9:.3g}; make it smaller"
        )


def upright(array: np.ndarray, affine: np.ndarray, path: str | Path, dtype=np.float32, noted: bool = True) -> Volume:
    """Return the volume of an array and its affine, with axes flipped and swapped to run along +x, +y, +z.

    Axes with a tilt that moves no voxel center by more than LARGEST_TILT are treated as upright, about the center of
    the volume. So are axes that are rotated together by at most LARGEST_ROTATION.

    Parameters
    ----------
    array : ndarray, shape (x, y, z) or (x, y, z, 1)
    affine : ndarray, shape (4, 4)
        From voxel index to RAS world mm.
    path : str or Path
        Beginning of messages.
    dtype : dtype or None, optional
        Data type of the result; None: the data type of the array.
    noted : bool, optional
        Report a small tilt.

    Raises
    ------
    InputError
        If the array is not 3D or not numeric, or its axes have no size or are tilted against the scanner's.
    """
    if array.dtype.kind not in "biuf":
        raise InputError(f"{path}: its voxels are of {array.dtype}, not numbers; give gray values")
    while array.ndim > 3 and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim != 3:
        raise InputError(f"{path}: has {array.ndim} dimensions; give a 3D image")
    if not np.isfinite(affine).all() or abs(np.linalg.det(affine[:3, :3])) < SMALLEST_VOXEL_MM3:
        raise InputError(f"{path}: its header gives voxels no size or position; repair its affine")
    orientation = nibabel.io_orientation(affine)
    if np.isnan(orientation).any():
        raise InputError(f"{path}: its header gives two axes one direction; repair its affine")
    affine = affine @ nibabel.orientations.inv_ornt_aff(orientation, array.shape)
    array = nibabel.apply_orientation(array, orientation)
    matrix = affine[:3, :3]
    spacing = np.linalg.norm(matrix, axis=0)
    half = (np.array(array.shape) - 1) / 2
    tilted = np.abs(matrix - np.diag(spacing))
    moved = float((tilted @ half / spacing).max())
    angle = math.degrees(math.acos(min(1.0, float((np.diag(matrix) / spacing).min()))))
    if moved > LARGEST_TILT and not is_small_rotation(matrix / spacing):
        raise InputError(
            f"{path}: its axes are tilted against the scanner's by up to {angle:.3g} degrees, which moves voxels by up "
            f"to {moved:.3g} voxels; resample it upright first. Allowed: {LARGEST_TILT:g} voxels, or a rotation of "
            f"{LARGEST_ROTATION:g} degrees without shear"
        )
    if noted and moved > SEEN_TILT:
        note(
            f"{path}: its axes are tilted by {angle:.2g} degrees and treated as upright, which moves voxels by up to "
            f"{moved:.2g} of their size"
        )
    centre = affine[:3, 3] + matrix @ half
    directions = tuple(map(tuple, (matrix / spacing).T.tolist())) if tilted.any() else None
    grid = Grid(array.shape[::-1], tuple(spacing[::-1]), tuple(centre), directions)
    return Volume(np.ascontiguousarray(array.T, dtype=dtype), grid)


def is_small_rotation(axes: np.ndarray) -> bool:
    """Return whether unit vectors (columns) are the frame's axes, rotated by at most LARGEST_ROTATION, unsheared."""
    angle = math.degrees(math.acos(np.clip((np.trace(axes) - 1) / 2, -1.0, 1.0)))
    return bool(np.abs(axes.T @ axes - np.eye(3)).max() <= ORTHOGONAL) and angle <= LARGEST_ROTATION


def write_nifti(volume: Volume, path: str | Path) -> None:
    """Write a volume (float32 or any integer type) as NIfTI-1 in mm, with the affine in both sform and qform.

    The gzip header has no time or name, so equal volumes give equal bytes.
    """
    affine = volume.grid.drawn_affine
    image = nibabel.Nifti1Image(volume.array.T, affine)
    image.header.set_xyzt_units("mm")
    image.set_sform(affine, code="scanner")
    image.set_qform(affine, code="scanner")
    with replacing(path) as temporary:
        nibabel.save(image, temporary)


def read_repeats(paths: Sequence[str | Path]) -> tuple[np.ndarray, Grid]:
    """Read NIfTI images of one scan, float64 of shape (repeats, z, y, x), and their grid.

    Raises
    ------
    InputError
        If the grids differ.
    """
    repeats = [read_nifti(path) for path in paths]
    grid = repeats[0].grid
    if odd := [path for path, volume in zip(paths, repeats, strict=True) if not volume.grid.matches(grid)]:
        raise InputError(f"{odd[0]}: is on another grid than {paths[0]}; make the images again")
    return np.stack([volume.array for volume in repeats]).astype(np.float64), grid
