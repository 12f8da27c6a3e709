"""Find all errors of a study in its configuration and the files that it names, before anything is computed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

from ...base.errors import InputError, lines_of
from ...base.streams import Branch, branch
from ...config.config import flat_detectors, inspected
from ...config.outputs import Files
from ...config.plan import Plan
from ...config.public_scans import PublicScans, made_folders
from ...diagnosis.candidate_effects import candidates, check_accuracy, check_kinds, shown_by
from ...projectors import choose_engine
from ...recordings.document import Document, read_document
from ..phantom_sources import PhantomSources
from ..proof import Proof
from .check_cache import cached_check
from .preflight_rois import roi_problems


def problems(settings: Mapping, scans: bool = False, keep: bool = False) -> list[str]:
    """Return one line for each error of a study: file or key, what is wrong, what to do.

    Sections that the schema refuses are reported once. Checks that depend on them are skipped.

    Parameters
    ----------
    settings : mapping
        Configuration, see `config.check`.
    scans : bool, optional
        Whether to read the files of recordings too, and to check that scans cover a synthetic phantom or a published
        CT. These checks take seconds. The coverage of a user's own CT is always checked.
    keep : bool, optional
        Whether to cache successful checks (check_cache).
    """
    lines, config = inspected(settings)
    if config:
        phantom = partial(_phantom, keep=keep, rois=_number_of_rois(settings))
        recordings = partial(_recordings, keep=keep)
        for check in (_results, _engine, _layout, _shapes, phantom, _scans, _parameters, _measured, recordings, _proof):
            lines += check(config)
        if scans:
            lines += _scanned(config)
    return list(dict.fromkeys(lines))


def _messages(function, *arguments) -> list[str]:
    """Return the message of the InputError that a function raises, if any."""
    try:
        function(*arguments)
    except InputError as error:
        return [str(error)]
    return []


def _results(config: dict) -> Iterator[str]:
    folder = Path(config["results_dir"])
    existing = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    if not existing.is_dir():
        yield f"results_dir: {existing} is a file; name a folder"
    elif not os.access(existing, os.W_OK):
        yield f"results_dir: {existing} is not writable; change its permissions or name another folder"


def _engine(config: dict) -> Iterator[str]:
    backprojector = config["reconstruction"]["sirt"]["backprojector"]
    yield from _messages(choose_engine, config["engine"], backprojector, True, flat_detectors(config))


def _layout(config: dict) -> Iterator[str]:
    """Check a user's layout of the synthetic phantom."""
    phantom = config.get("phantom", {})
    if phantom.get("source") == "synthetic" and phantom["layout"] is not None:
        from ...phantom.layout import read_layout  # slow import

        yield from _messages(read_layout, phantom["layout"])


def _shapes(config: dict) -> Iterator[str]:
    """Check a phantom of shapes."""
    phantom = config.get("phantom", {})
    if phantom.get("source") == "object" and "object" in phantom:
        from ...physics.scenes.objects import read_phantom_rois  # slow import (numba)

        yield from (f"phantom.object: {line}" for line in _messages(read_phantom_rois, phantom["object"]))


def _seen_shapes(config: dict) -> Iterator[str]:
    """Check that scans cover a phantom of shapes."""
    if "grid" not in config or "object" not in config["phantom"] or list(_shapes(config)):
        return
    from ...physics.scenes.objects import read_phantom_object
    from ...physics.scenes.voxelized import reach_mm, voxelize_rois  # slow import
    from .preflight_scan import blind_spots, world_grid

    grid, (shaped, rois) = world_grid(config), read_phantom_object(config["phantom"]["object"])
    try:
        masks = {roi.name: roi.mask for roi in voxelize_rois(shaped, grid, rois)}
    except InputError as error:
        yield str(error)
        return
    yield from blind_spots(config, grid, reach_mm(shaped), masks, math.hypot(*grid.spacing[1:]) / 2)


def _scanned(config: dict) -> Iterator[str]:
    """Check the files of recordings, and that scans cover the synthetic phantom or an available published CT."""
    yield from _recorded(config)
    phantom = config.get("phantom", {})
    if phantom.get("source") == "ct" and _has_ct(phantom):
        sources = PhantomSources(Plan(config))
        if sources.published and not sources.absent and not _messages(sources.check):
            from .preflight_ct import ct_problems

            yield from ct_problems(config)
    if phantom.get("source") == "object":
        yield from _seen_shapes(config)
    if phantom.get("source") != "synthetic" or "grid" not in config or list(_layout(config)):
        return
    from ...phantom.layout import read_layout
    from ...phantom.synthetic import find_outline  # slow import
    from .preflight_scan import blind_spots, world_grid

    grid = world_grid(config)
    try:
        reach, rois = find_outline(read_layout(phantom["layout"]), grid, branch(config["seed"], Branch.PHANTOM))
    except InputError as error:
        yield str(error)
        return
    # `reach` is the edge of the shapes; the centers of voxels lie closer to the axis.
    slack = math.hypot(*grid.spacing[1:]) / 2
    yield from blind_spots(config, grid, reach, {roi.name: roi.mask for roi in rois}, slack)


def _has_ct(phantom: dict) -> bool:
    """Whether the configuration has a valid CT and valid ROIs."""
    return {"image", "rois"} <= phantom.get("ct", {}).keys()


def _number_of_rois(settings: Mapping) -> int:
    """Return the number of entries of phantom.ct.rois, including invalid ones."""
    for key in ("phantom", "ct", "rois"):
        settings = settings.get(key) if isinstance(settings, Mapping) else None
    return len(settings) if isinstance(settings, list) else 0


def _phantom(config: dict, keep: bool, rois: int) -> Iterator[str]:
    """Check a CT and its ROIs; `rois` is the number of entries before invalid ones were removed."""
    phantom = config.get("phantom", {})
    if phantom.get("source") != "ct" or not _has_ct(phantom):
        return
    classes = {roi["tissue_class"] for roi in phantom["ct"]["rois"]}
    if len(classes) == 1 and len(phantom["ct"]["rois"]) == rois and "stability" in config["analyses"]:
        yield (
            f"config: phantom.ct.rois all have tissue_class {min(classes)}; analyses.stability compares at least two "
            "classes, so add ROIs of another class or set analyses.stability: null"
        )
    sources = PhantomSources(Plan(config))
    if damaged := _messages(sources.check):
        yield from damaged
    elif not sources.published and not sources.made:  # published files have a SHA-256; made files do not exist yet
        yield from cached_check(config, sources.paths, lambda: _ct(config), keep)


def _ct(config: dict) -> Iterator[str]:
    from .preflight_ct import ct_problems  # slow import

    yield from ct_problems(config)


def _parameters(config: dict) -> Iterator[str]:
    """Check the parameter file of features."""
    if file := config.get("features", {}).get("parameters"):
        from ...features.parameters import read_parameters  # slow import (pyradiomics)

        yield from _messages(read_parameters, file)


def _scans(config: dict) -> Iterator[str]:
    """Check the selected public scans."""
    yield from _messages(PublicScans(Plan(config)).check)


def _measured(config: dict) -> Iterator[str]:
    table = config["measured"]["table"]
    if table is not None and not Path(table).is_file():
        yield f"measured.table: {table}: no such file; give the path of the table, or null for the group means"


def _recordings(config: dict, keep: bool) -> Iterator[str]:
    """Check the documents of recordings and the settings of their diagnosis."""
    documents: dict[str, Document] = {}
    scans = PublicScans(Plan(config))
    for name, folder in config["recordings"].items():
        try:
            documents[name] = scans.document(folder)
        except InputError as error:
            yield from lines_of(error)
    yield from roi_problems(config, documents)
    diagnosed = config["diagnosis"]["recordings"]
    yield from _messages(check_accuracy, config["diagnosis"]["model_accuracy"])
    for name, entry in diagnosed.items():
        where = f"diagnosis.recordings.{name}"
        yield from _object(entry.get("object", {}), f"{where}.object", keep)
        if name not in documents or entry.get("physics_from", name) not in documents:
            continue
        if lines := _messages(check_kinds, {name: entry}, documents):
            yield from lines
        elif "physics_from" not in entry:
            lines = _messages(partial(candidates, **shown_by(documents[name].content)), entry)
            yield from (f"{where}: {line}" for line in lines)


def _recorded(config: dict) -> Iterator[str]:
    """Check the data files of recordings."""
    made = made_folders(config).values()
    folders = [folder for folder in config["recordings"].values() if folder not in made]
    if not folders:
        return
    from ...features.names import FEATURES
    from ...features.parameters import read_parameters  # slow import (pyradiomics)
    from ...recordings.reading import load_recording

    file, features = config.get("features", {}).get("parameters"), FEATURES
    if file and not _messages(read_parameters, file):
        features = read_parameters(file).features
    for folder in dict.fromkeys(folders):
        try:
            files = read_document(folder).files
        except InputError:  # reported by `_recordings`
            continue

        def check(folder: str = folder) -> list[str]:
            try:
                load_recording(folder, features)
            except InputError as error:
                return list(lines_of(error))
            return []

        yield from cached_check({"recording": folder, "features": list(features)}, files, check)


def _object(settings: Mapping, where: str, keep: bool) -> Iterator[str]:
    """Check the description of a scanned object."""
    mask = settings.get("mask")
    if mask is not None and not Path(mask).is_file():
        yield f"{where}.mask: {mask}: no such file; give the path of a NIfTI image"
    if {"labels", "materials"} <= set(settings):
        lines = cached_check(settings, [settings["labels"]], lambda: _labels(settings), keep)
        yield from (f"{where}: {line}" for line in lines)
    if "kind" in settings:
        from ...physics.scenes.objects import read_object  # slow import (numba)

        lines = _messages(read_object, settings["kind"], settings.get("parameters"))
        yield from (f"{where}: {line}" for line in lines)


def _labels(settings: Mapping) -> list[str]:
    from ...physics.scenes.labeled import read_label_map  # slow import (numba)

    return _messages(read_label_map, settings["labels"], settings["materials"])


def _proof(config: dict) -> Iterator[str]:
    yield from _messages(Proof.read, Plan(config), Files(config["results_dir"]))
