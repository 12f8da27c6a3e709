"""Phantom, scans, images and features: the steps of a study as functions, by default of config/paper_groups.yaml."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from ..base.errors import InputError, did_you_mean
from ..base.geometry import Grid, ScanGeometry, scan_geometry
from ..base.home import expand_home
from ..base.settings import FbpSettings, ScanSettings, SirtSettings, from_mapping
from ..base.streams import Branch, branch
from ..features import extraction
from ..io.schema import defaults_of, fill_defaults, schema_of, validate
from ..io.study_sizes import paper_groups
from ..io.volumes import Volume, check_fits
from ..phantom import Phantom, ct, layout, synthetic
from ..physics.beam.materials import Segmentation
from ..physics.beam.sensors import Sensor
from ..physics.effect import acts_on_images, checked
from ..physics.scenes.line_integrals import check_rois_seen
from ..projectors import astra_projects, choose_engine
from ..simulation import reconstruct as images_of
from ..simulation.acquire import acquire
from ..simulation.project import project_phantom
from .arguments import (
    check_integer,
    check_made_by,
    check_mapping,
    check_pair,
    check_path,
    check_positive,
    check_sequence,
    check_text,
    check_three,
    plain,
    public,
)

STUDY = paper_groups()
SHAPE, SPACING_MM = (tuple(STUDY["grid"][key]) for key in ("shape", "spacing_mm"))
LEVEL = STUDY["analyses"]["stability"]["noise"]
NOISE_LEVEL = STUDY["levels"][LEVEL]["A"]  # the noise variance of 10 mGy on the printed phantom
PROJECTIONS = 300
MAX_OVERSAMPLING = schema_of("grid")["properties"]["oversampling"]["maximum"]
LARGEST_SEED = 2**128 - 1  # more entropy than NumPy's generator has


@dataclass(frozen=True)
class Scan:
    """Acquisitions of one phantom in one geometry.

    Attributes
    ----------
    grid : Grid
        Grid of the phantom and of reconstructed images.
    line_integrals : ndarray of float32, shape (repeats, views, rows, columns)
        With noise.
    clean : ndarray, shape (views, rows, columns)
        Line integrals without noise.
    image_physics : dict of str to dict of str to float
        Effects that act on images, with all parameters: {effect: {parameter: value}}.
    mu_water_per_mm : float
        Attenuation of water, 1/mm.
    """

    geometry: ScanGeometry
    grid: Grid
    line_integrals: np.ndarray = field(repr=False)
    clean: np.ndarray = field(repr=False)
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
    """Draw the abdomen phantom with its six regions, or another layout.

    Parameters
    ----------
    shape : tuple of 3 int, optional
        Number of voxels of the images (z, y, x).
    spacing_mm : tuple of 3 float, optional
        Voxel size (z, y, x), mm.
    layout_file : str or Path, optional
        Shapes and tissues, in the format of resources/phantom.yaml in the package; None: the abdomen.
    oversampling : int, optional
        Factor by which the scanned phantom is finer than the images.
    seed : int, optional
        Seed of the textures.

    Returns
    -------
    Phantom
        `image` and `fine` in HU, `rois`.

    Raises
    ------
    InputError
        For an invalid layout, or one that does not fit the grid.
    """
    oversampling = check_integer(oversampling, "oversampling", 1, MAX_OVERSAMPLING)
    grid = _grid(shape, spacing_mm, oversampling)
    seed = check_integer(seed, "seed", 0, LARGEST_SEED)
    drawn = layout.read_layout(None if layout_file is None else check_path(layout_file, "layout_file"))
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
    """Create a phantom from a CT and its regions.

    Parameters
    ----------
    image : str or Path
        NIfTI file, or folder with one DICOM CT series.
    rois : sequence of mapping
        As `phantom.ct.rois` in the configuration, for example {"name": "liver", "tissue_class": "liver", "label": 5}.
    labels : str or Path, optional
        Label map, DICOM SEG or RTSTRUCT for the regions whose mapping has no `file`.
    shape, spacing_mm, oversampling : optional
        As in draw_phantom.
    **places
        `centre_mm`, `keep_mm`, `not_checked`: as in the configuration.

    Raises
    ------
    InputError
        For an unusable image, region or setting (phantom.ct.load_phantom).
    """
    regions = check_sequence(rois, "rois", "mappings with name and tissue_class")
    settings = {"image": check_path(image, "image"), "rois": [plain(region) for region in regions], **plain(places)}
    if labels is not None:
        settings["labels"] = check_path(labels, "labels")
    finer = check_integer(oversampling, "oversampling", 1, MAX_OVERSAMPLING)
    return ct.load_phantom(ct.read_settings(expand_home(settings)), _grid(shape, spacing_mm, finer), finer)


def _grid(shape: object, spacing_mm: object, oversampling: int) -> Grid:
    count = functools.partial(check_integer, least=1)
    grid = Grid(check_three(shape, "shape", count), check_three(spacing_mm, "spacing_mm", check_positive))
    check_fits(4 * math.prod(grid.shape) * oversampling**3, f"shape {grid.shape} with oversampling {oversampling}")
    return grid


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
    """Simulate scans of a phantom.

    Parameters
    ----------
    projections : int, optional
        Number of views.
    noise_level : float, optional
        A: the inverse of the number of photons per pixel in air.
    repeats : int, optional
        Number of acquisitions with independent noise.
    physics : mapping of str to mapping of str to float, optional
        {effect: {parameter: value}}; omitted parameters have typical values. Noise is then simulated for an
        energy-integrating detector.
    seed : int, optional
        Seed of the noise.
    stream : tuple of (str, str), optional
        Labels of geometry and noise level, which select the random stream of the noise as in a study. None: labels of
        config/paper_groups.yaml for this number of projections and "dose10".
    **scanner
        Keys of the configuration's section `scan` that differ from config/paper_groups.yaml: `trajectory`, `pitch`,
        `columns`, `rows`, `source_to_isocentre_mm`, ...

    Raises
    ------
    InputError
        For invalid keys and values, unknown effects, a phantom that the scan truncates, and regions that it does not
        cover completely.
    """
    check_made_by(phantom, Phantom, "phantom", "draw_phantom or read_phantom")
    projections, repeats = check_integer(projections, "projections", 1), check_integer(repeats, "repeats", 1)
    noise_level, threads = check_positive(noise_level, "noise_level"), check_integer(threads, "threads", 1)
    seed = check_integer(seed, "seed", 0, LARGEST_SEED)
    physics = plain(check_mapping({} if physics is None else physics, "physics", "{effect: {parameter: value}}"))
    if stream is not None:
        labels = check_pair(stream, "stream", "labels of geometry and noise level")
        stream = tuple(check_text(label, "stream") for label in labels)
    effects = checked(physics)
    section = STUDY["scan"] | plain(scanner)
    validate(section, schema_of("scan"), "scan")
    fill_defaults(section, schema_of("scan"))
    geometry = scan_geometry(from_mapping(ScanSettings, section), projections, phantom.image.grid)
    check_rois_seen(geometry, phantom.image.grid, {roi.name: roi.mask for roi in phantom.rois})
    before = {name: values for name, values in effects.items() if not acts_on_images(name)}
    mu_water_per_mm = defaults_of()["mu_water_per_mm"]
    clean, state = project_phantom(
        phantom.fine,
        geometry,
        before,
        mu_water_per_mm=mu_water_per_mm,
        materials=Segmentation(**defaults_of("materials")),
        sensor=Sensor(**defaults_of("sensor")),
        threads=threads,
        samples=section["samples"],
    )
    noise = defaults_of("noise")
    label, level = stream or (f"views{projections}", LEVEL)
    noisy = [
        acquire(
            clean,
            geometry=label,
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
    """Reconstruct an image of every repeat of a scan.

    Parameters
    ----------
    algorithm : {"fbp", "sirt"}, optional
    engine : {"auto", "cpu", "astra_cuda"}, optional
    **settings
        Settings of the algorithm, as under `reconstruction` in the configuration: `iterations`, `solver`,
        `normalise`, ...

    Returns
    -------
    list of Volume
        int16 HU on the phantom's grid.

    Raises
    ------
    InputError
        For an unknown algorithm or invalid settings.
    """
    known = defaults_of("reconstruction")
    if check_text(algorithm, "algorithm") not in known:
        raise InputError(f"algorithm '{algorithm}' is unknown; {did_you_mean(algorithm, known)}")
    settings = plain(settings)
    validate(settings, schema_of("reconstruction", algorithm), algorithm)
    check_made_by(scan, Scan, "scan", "vp.scan")
    chosen = known[algorithm] | settings
    threads, engine = check_integer(threads, "threads", 1), check_text(engine, "engine")
    return images_of.reconstruct(
        scan.line_integrals,
        scan.geometry,
        scan.grid,
        algorithm,
        from_mapping({"sirt": SirtSettings, "fbp": FbpSettings}[algorithm], chosen),
        engine=choose_engine(
            engine,
            backprojector=chosen.get("backprojector"),
            normalise=chosen.get("normalise"),
            flat=astra_projects(scan.geometry),
        ),
        mu_water_per_mm=scan.mu_water_per_mm,
        physics=scan.image_physics,
        threads=threads,
    )


@public
def extract(images: Volume | Sequence[Volume], phantom: Phantom) -> pd.DataFrame:
    """Extract the 86 features of every region of a phantom from images of it.

    Parameters
    ----------
    images : Volume or sequence of Volume
        HU.

    Returns
    -------
    DataFrame
        One row per image and region: image (number, from 0), roi, tissue_class, n_voxels, grey_levels, and the features
        with pyradiomics' names.

    Raises
    ------
    InputError
        For an image on another grid, and a region without two gray levels.
    """
    check_made_by(phantom, Phantom, "phantom", "draw_phantom or read_phantom")
    if isinstance(images, Volume):
        images = [images]
    images = check_sequence(images, "images", "images, as vp.reconstruct returns")
    for number, image in enumerate(images):
        check_made_by(image, Volume, f"images[{number}]", "vp.reconstruct")
    if not images:
        raise InputError("images: is empty; give at least one image")
    masks = {roi.name: roi.mask for roi in phantom.rois}
    classes = {roi.name: roi.tissue_class for roi in phantom.rois}
    front, found = ["image", "roi", "tissue_class", "n_voxels", "grey_levels"], []
    for number, image in enumerate(images):
        if not image.grid.matches(phantom.image.grid):
            raise InputError(
                f"images[{number}]: is on another grid ({image.grid}) than the phantom ({phantom.image.grid}); "
                "reconstruct a scan of this phantom"
            )
        table = extraction.extract(image, masks, name=f"image {number}")
        table = table.assign(image=number, tissue_class=table["roi"].map(classes))
        found.append(table[[*front, *extraction.FEATURES]])
    return pd.concat(found, ignore_index=True)
