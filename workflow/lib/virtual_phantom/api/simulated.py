"""A phantom, its scans, images and features: the steps of the study as functions, with the default study's numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ..base.errors import InputError, meant
from ..base.geometry import Grid, ScanGeometry, scan_geometry
from ..base.home import expand_home
from ..base.streams import Branch, branch
from ..features import extraction
from ..io.default_study import default_study
from ..io.schema import defaults_of, fill_defaults, schema_of, validate
from ..io.volumes import Volume
from ..phantom import Phantom, ct, layout, synthetic
from ..physics.effect import acts_on_images, checked
from ..physics.scenes.line_integrals import check_rois_seen
from ..projectors import astra_projects, choose_engine
from ..simulation import reconstruct as images_of
from ..simulation.acquire import acquire
from ..simulation.project import projected
from .arguments import made_by, mapping, pair, path, positive, public, sequence, text, three, whole

STUDY = default_study()
SHAPE, SPACING_MM = (tuple(STUDY["grid"][key]) for key in ("shape", "spacing_mm"))
LEVEL = STUDY["analyses"]["stability"]["noise"]
NOISE_LEVEL = STUDY["levels"][LEVEL]["A"]  # the variance of 10 mGy on the printed phantom
PROJECTIONS = 300
FINEST = schema_of("grid")["properties"]["oversampling"]["maximum"]
LARGEST_SEED = 2**128 - 1  # more entropy than NumPy's generator has


@dataclass(frozen=True)
class Scan:
    """Acquisitions of one phantom in one geometry.

    Attributes
    ----------
    grid : Grid
        Of the phantom, on which images are made.
    line_integrals : ndarray of float32, shape (repeats, views, rows, columns)
        With noise.
    clean : ndarray, shape (views, rows, columns)
        Without.
    image_physics : dict of str to dict of str to float
        Effects that act on images: {effect: {parameter: value}}, complete.
    mu_water_per_mm : float
        1/mm.
    """

    geometry: ScanGeometry
    grid: Grid
    line_integrals: np.ndarray
    clean: np.ndarray
    image_physics: dict[str, dict[str, float]]
    mu_water_per_mm: float


@public
def draw_phantom(
    shape: tuple[int, int, int] = SHAPE,
    spacing_mm: tuple[float, float, float] = SPACING_MM,
    *,
    layout_file: str | Path | None = None,
    oversampling: int = 2,
    seed: int = 2022,
) -> Phantom:
    """The drawn abdomen with its six regions, or another layout.

    Parameters
    ----------
    shape : tuple of 3 int, optional
        Voxels of the images (z, y, x).
    spacing_mm : tuple of 3 float, optional
        Their size (z, y, x), mm.
    layout_file : str or Path, optional
        Shapes and tissues, as docs/how-to/phantoms.md says; None: the abdomen.
    oversampling : int, optional
        How many times finer what is scanned is drawn.
    seed : int, optional
        Of the textures.

    Returns
    -------
    Phantom
        `image` and `fine` in HU, `rois`.

    Raises
    ------
    InputError
        For a layout that cannot be drawn, and a grid that it does not fit.
    """
    grid = _grid(shape, spacing_mm)
    oversampling, seed = whole(oversampling, "oversampling", 1, FINEST), whole(seed, "seed", 0, LARGEST_SEED)
    drawn = layout.read_layout(None if layout_file is None else path(layout_file, "layout_file"))
    return synthetic.build(drawn, grid, oversampling, branch(seed, Branch.PHANTOM))


@public
def read_phantom(
    image: str | Path,
    rois: Sequence[Mapping],
    *,
    labels: str | Path | None = None,
    shape: tuple[int, int, int] = SHAPE,
    spacing_mm: tuple[float, float, float] = SPACING_MM,
    oversampling: int = 2,
    **places,
) -> Phantom:
    """A phantom from a CT and its regions.

    Parameters
    ----------
    image : str or Path
        NIfTI file, or folder with one DICOM CT series.
    rois : sequence of mapping
        As `phantom.ct.rois` in the configuration, for example {"name": "liver", "tissue_class": "liver", "label": 5}.
    labels : str or Path, optional
        Label map, DICOM SEG or RTSTRUCT of the regions that name no file of their own.
    shape, spacing_mm, oversampling : optional
        As draw_phantom takes them.
    **places
        `centre_mm`, `keep_mm`, `not_checked`: as in the configuration.

    Raises
    ------
    InputError
        For an unusable image, region or setting (phantom.ct.load).
    """
    regions = sequence(rois, "rois", "mappings with name and tissue_class")
    settings = {"image": path(image, "image"), "rois": [_plain(one) for one in regions], **_plain(places)}
    if labels is not None:
        settings["labels"] = path(labels, "labels")
    return ct.load(expand_home(settings), _grid(shape, spacing_mm), whole(oversampling, "oversampling", 1, FINEST))


def _grid(shape: object, spacing_mm: object) -> Grid:
    return Grid(three(shape, "shape", lambda one, name: whole(one, name, 1)), three(spacing_mm, "spacing_mm", positive))


def _plain(value: object) -> object:
    """Numbers and arrays of NumPy, paths and tuples as YAML has them, for the schema."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, Path) else value


@public
def scan(
    phantom: Phantom,
    *,
    projections: int = PROJECTIONS,
    noise_level: float = NOISE_LEVEL,
    repeats: int = 1,
    physics: Mapping[str, Mapping[str, float] | None] | None = None,
    seed: int = 2022,
    stream: tuple[str, str] | None = None,
    threads: int = 1,
    **scanner,
) -> Scan:
    """Scan a phantom.

    Parameters
    ----------
    projections : int, optional
        Views of the whole scan.
    noise_level : float, optional
        A: one over the photons per pixel in air.
    repeats : int, optional
        Acquisitions, each with noise of its own.
    physics : mapping of str to mapping of str to float, optional
        {effect: {parameter: value}}; omitted parameters have their typical values. The noise is then that of a
        detector that weights photons by their energy.
    seed : int, optional
        Of the noise.
    stream : tuple of (str, str), optional
        Labels of geometry and noise level that pick the noise's random stream, as a study has them; None: of the
        number of projections and "dose10", those of the default study.
    **scanner
        Keys of the configuration's section `scan` that differ from the default study's: `trajectory`, `pitch`,
        `columns`, `rows`, `source_to_isocentre_mm`, ...

    Raises
    ------
    InputError
        For keys and values that the configuration does not take, unknown effects, a phantom that the scan truncates,
        and regions that it does not see whole.
    """
    made_by(phantom, Phantom, "phantom", "draw_phantom or read_phantom")
    projections, repeats = whole(projections, "projections", 1), whole(repeats, "repeats", 1)
    noise_level, threads = positive(noise_level, "noise_level"), whole(threads, "threads", 1)
    seed = whole(seed, "seed", 0, LARGEST_SEED)
    physics = _plain(mapping({} if physics is None else physics, "physics", "{effect: {parameter: value}}"))
    if stream is not None:
        stream = tuple(text(one, "stream") for one in pair(stream, "stream", "labels of geometry and noise level"))
    effects = checked(physics)
    section = STUDY["scan"] | _plain(scanner)
    validate(section, schema_of("scan"), "scan")
    fill_defaults(section, schema_of("scan"))
    geometry = scan_geometry(section, projections, phantom.image.grid)
    check_rois_seen(geometry, phantom.image.grid, {roi.name: roi.mask for roi in phantom.rois})
    before = {name: values for name, values in effects.items() if not acts_on_images(name)}
    mu_water_per_mm = defaults_of()["mu_water_per_mm"]
    clean, state = projected(
        phantom.fine,
        geometry,
        before,
        mu_water_per_mm=mu_water_per_mm,
        materials=defaults_of("materials"),
        sensor=defaults_of("sensor"),
        threads=threads,
    )
    noise = defaults_of("noise")
    where, level = stream or (f"views{projections}", LEVEL)
    noisy = [
        acquire(
            clean,
            geometry=where,
            noise=level,
            noise_level=noise_level,
            seed=repeat,
            model="physical" if before else noise["model"],
            study_seed=seed,
            draws=noise["draws"],
            state=state,
        ).line_integrals(noise["zero_counts_as"])
        for repeat in range(repeats)
    ]
    after = {name: values for name, values in effects.items() if acts_on_images(name)}
    return Scan(geometry, phantom.image.grid, np.stack(noisy), clean, after, mu_water_per_mm)


@public
def reconstruct(
    scan: Scan, algorithm: str = "fbp", *, engine: str = "auto", threads: int = 1, **settings
) -> list[Volume]:
    """Images of every repeat of a scan.

    Parameters
    ----------
    algorithm : {"fbp", "sirt"}, optional
    engine : {"auto", "cpu", "astra_cuda"}, optional
        Of SIRT.
    **settings
        Of the algorithm, as under `reconstruction` in the configuration: `iterations`, `solver`, `normalise`, ...

    Returns
    -------
    list of Volume
        int16 HU on the phantom's grid.

    Raises
    ------
    InputError
        For an unknown algorithm, and settings that the configuration does not take.
    """
    known = defaults_of("reconstruction")
    if text(algorithm, "algorithm") not in known:
        raise InputError(f"algorithm '{algorithm}' is unknown; {meant(algorithm, known)}")
    settings = _plain(settings)
    validate(settings, schema_of("reconstruction", algorithm), algorithm)
    made_by(scan, Scan, "scan", "vp.scan")
    threads, engine = whole(threads, "threads", 1), text(engine, "engine")
    return images_of.reconstruct(
        scan.line_integrals,
        scan.geometry,
        scan.grid,
        algorithm,
        known[algorithm] | settings,
        engine=choose_engine(
            engine,
            (known["sirt"] | settings).get("backprojector"),
            flat=astra_projects(scan.geometry),
        ),
        mu_water_per_mm=scan.mu_water_per_mm,
        physics=scan.image_physics,
        threads=threads,
    )


@public
def extract(images: Volume | Sequence[Volume], phantom: Phantom) -> pd.DataFrame:
    """The 86 features of every region of a phantom in images of it.

    Parameters
    ----------
    images : Volume or sequence of Volume
        HU.

    Returns
    -------
    DataFrame
        One row per image and region: image (its number, from 0), roi, tissue_class, n_voxels, grey_levels, and the
        features by pyradiomics' names.

    Raises
    ------
    InputError
        For an image on another grid, and a region without two grey levels.
    """
    made_by(phantom, Phantom, "phantom", "draw_phantom or read_phantom")
    given = [images] if isinstance(images, Volume) else sequence(images, "images", "images, as vp.reconstruct returns")
    images = [made_by(one, Volume, f"images[{number}]", "vp.reconstruct") for number, one in enumerate(given)]
    if not images:
        raise InputError("images: is empty; give at least one image")
    masks = {roi.name: roi.mask for roi in phantom.rois}
    classes = {roi.name: roi.tissue_class for roi in phantom.rois}
    front, found = ["image", "roi", "tissue_class", "n_voxels", "grey_levels"], []
    for number, one in enumerate(images):
        if not one.grid.matches(phantom.image.grid):
            raise InputError(f"image {number}: is on another grid ({one.grid}) than the phantom ({phantom.image.grid})")
        table = extraction.extract(one, masks, name=f"image {number}")
        table = table.assign(image=number, tissue_class=table["roi"].map(classes))
        found.append(table[[*front, *extraction.FEATURES]])
    return pd.concat(found, ignore_index=True)
