"""All that is wrong with a study, from its configuration and the files that it names, before anything is computed."""

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
from .check_cache import look_once
from .preflight_rois import roi_problems


def problems(settings: Mapping, scans: bool = False, keep: bool = False) -> list[str]:
    """What is wrong with a study, a line for each mistake.

    Parameters
    ----------
    settings : mapping
        A configuration as `config.check` takes it.
    scans : bool, optional
        Whether to read the files of recordings too, and to look if scans see all of a synthetic phantom or of a
        published CT, which takes seconds; at a CT of the user's own this is always looked.
    keep : bool, optional
        Whether to remember what was right, so that the next look is fast (kept_checks).

    Returns
    -------
    list of str
        The file or the key, what is wrong with it, and what to do. Of a section that the schema refuses, what depends
        on it is not looked at.
    """
    lines, config = inspected(settings)
    if config:
        phantom, recordings = (
            partial(_phantom, keep=keep, rois=_number_of_rois(settings)),
            partial(_recordings, keep=keep),
        )
        for look in (_results, _engine, _layout, _shapes, phantom, _scans, _parameters, _measured, recordings, _proof):
            lines += look(config)
        if scans:
            lines += _scanned(config)
    return list(dict.fromkeys(lines))


def _said(function, *arguments) -> list[str]:
    """What an InputError of a function says."""
    try:
        function(*arguments)
    except InputError as error:
        return [str(error)]
    return []


def _results(config: dict) -> Iterator[str]:
    folder = Path(config["results_dir"])
    there = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    if not there.is_dir():
        yield f"results_dir: {there} is a file; name a folder"
    elif not os.access(there, os.W_OK):
        yield f"results_dir: {there} may not be written to; change its permissions or name another folder"


def _engine(config: dict) -> Iterator[str]:
    backprojector = config["reconstruction"]["sirt"]["backprojector"]
    yield from _said(choose_engine, config["engine"], backprojector, True, flat_detectors(config))


def _layout(config: dict) -> Iterator[str]:
    """Of the synthetic phantom."""
    phantom = config.get("phantom", {})
    if phantom.get("source") == "synthetic" and phantom["layout"] is not None:  # that of the library is right
        from ...phantom.layout import read_layout  # heavy, for those who get here

        yield from _said(read_layout, phantom["layout"])


def _shapes(config: dict) -> Iterator[str]:
    """Of a phantom of shapes."""
    phantom = config.get("phantom", {})
    if phantom.get("source") == "object" and "object" in phantom:
        from ...physics.scenes.objects import read_phantom_rois  # loads numba, for those who get here

        yield from (f"phantom.object: {line}" for line in _said(read_phantom_rois, phantom["object"]))


def _seen_shapes(config: dict) -> Iterator[str]:
    """Whether scans see all of a phantom of shapes."""
    if "grid" not in config or "object" not in config["phantom"] or list(_shapes(config)):
        return
    from ...physics.scenes.objects import read_phantom_object
    from ...physics.scenes.voxelized import reach_mm, voxelize_rois  # heavy, for those who get here
    from .preflight_scan import blind_spots, grid_here

    grid, (shaped, rois) = grid_here(config), read_phantom_object(config["phantom"]["object"])
    try:
        masks = {roi.name: roi.mask for roi in voxelize_rois(shaped, grid, rois)}
    except InputError as error:
        yield str(error)
        return
    yield from blind_spots(config, grid, reach_mm(shaped), masks, math.hypot(*grid.spacing[1:]) / 2)


def _scanned(config: dict) -> Iterator[str]:
    """Whether recordings can be read, and scans see the synthetic phantom, or a published CT that is here already."""
    yield from _recorded(config)
    phantom = config.get("phantom", {})
    if phantom.get("source") == "ct" and _has_ct(phantom):
        sources = PhantomSources(Plan(config))
        if sources.published and not sources.absent and not _said(sources.check):
            from .preflight_ct import ct_problems

            yield from ct_problems(config)
    if phantom.get("source") == "object":
        yield from _seen_shapes(config)
    if phantom.get("source") != "synthetic" or "grid" not in config or list(_layout(config)):
        return
    from ...phantom.layout import read_layout
    from ...phantom.synthetic import find_outline  # heavy, for those who get here
    from .preflight_scan import blind_spots, grid_here

    grid = grid_here(config)
    try:
        reach, rois = find_outline(read_layout(phantom["layout"]), grid, branch(config["seed"], Branch.PHANTOM))
    except InputError as error:
        yield str(error)
        return
    # The reach is that of shapes; voxels' centres lie farther in.
    slack = math.hypot(*grid.spacing[1:]) / 2
    yield from blind_spots(config, grid, reach, {roi.name: roi.mask for roi in rois}, slack)


def _has_ct(phantom: dict) -> bool:
    """Whether a CT and its ROIs are named, and the schema refuses neither."""
    return {"image", "rois"} <= phantom.get("ct", {}).keys()


def _number_of_rois(settings: Mapping) -> int:
    """Number of entries of phantom.ct.rois, of which the schema may refuse some."""
    for key in ("phantom", "ct", "rois"):
        settings = settings.get(key) if isinstance(settings, Mapping) else None
    return len(settings) if isinstance(settings, list) else 0


def _phantom(config: dict, keep: bool, rois: int) -> Iterator[str]:
    """Of a CT and its ROIs, of which the user gave so many."""
    phantom = config.get("phantom", {})
    if phantom.get("source") != "ct" or not _has_ct(phantom):
        return
    classes = {roi["tissue_class"] for roi in phantom["ct"]["rois"]}
    if len(classes) == 1 and len(phantom["ct"]["rois"]) == rois and "stability" in config["analyses"]:
        yield (
            f"config: phantom.ct.rois are all of tissue_class {min(classes)}; analyses.stability compares at least two "
            "classes, so give ROIs of another, or set analyses.stability: null"
        )
    sources = PhantomSources(Plan(config))
    if damaged := _said(sources.check):
        yield from damaged
    elif not sources.published and not sources.made:  # those have their SHA-256, and these are not here yet
        yield from look_once(config, sources.paths, lambda: _ct(config), keep)


def _ct(config: dict) -> Iterator[str]:
    from .preflight_ct import ct_problems  # heavy, for those who get here

    yield from ct_problems(config)


def _parameters(config: dict) -> Iterator[str]:
    """The parameter file of features."""
    if file := config.get("features", {}).get("parameters"):
        from ...features.parameters import read_parameters  # loads pyradiomics, for those who get here

        yield from _said(read_parameters, file)


def _scans(config: dict) -> Iterator[str]:
    """Public scans that are asked for."""
    yield from _said(PublicScans(Plan(config)).check)


def _measured(config: dict) -> Iterator[str]:
    table = config["measured"]["table"]
    if table is not None and not Path(table).is_file():
        yield f"measured.table: {table}: no such file; give the path of the table, or null for the group means"


def _recordings(config: dict, keep: bool) -> Iterator[str]:
    """Recordings and what is asked of the diagnosis of them."""
    documents: dict[str, Document] = {}
    scans = PublicScans(Plan(config))
    for name, folder in config["recordings"].items():
        try:
            documents[name] = scans.document(folder)
        except InputError as error:
            yield from lines_of(error)
    yield from roi_problems(config, documents)
    diagnosed = config["diagnosis"]["recordings"]
    yield from _said(check_accuracy, config["diagnosis"]["model_accuracy"])
    for name, one in diagnosed.items():
        where = f"diagnosis.recordings.{name}"
        yield from _object(one.get("object", {}), f"{where}.object", keep)
        if name not in documents or one.get("physics_from", name) not in documents:
            continue
        if wrong := _said(check_kinds, {name: one}, documents):
            yield from wrong
        elif "physics_from" not in one:
            said = _said(partial(candidates, **shown_by(documents[name].content)), one)
            yield from (f"{where}: {line}" for line in said)


def _recorded(config: dict) -> Iterator[str]:
    """What is wrong in the files of recordings, which jobs read again."""
    made = made_folders(config).values()
    folders = [folder for folder in config["recordings"].values() if folder not in made]
    if not folders:
        return
    from ...features.names import FEATURES
    from ...features.parameters import read_parameters  # loads pyradiomics, for those who get here
    from ...recordings.reading import load_recording

    file, features = config.get("features", {}).get("parameters"), FEATURES
    if file and not _said(read_parameters, file):
        features = read_parameters(file).features
    for folder in dict.fromkeys(folders):
        try:
            files = read_document(folder).files
        except InputError:  # `_recordings` says so
            continue

        def look(folder: str = folder) -> list[str]:
            try:
                load_recording(folder, features)
            except InputError as error:
                return list(lines_of(error))
            return []

        yield from look_once({"recording": folder, "features": list(features)}, files, look)


def _object(settings: Mapping, where: str, keep: bool) -> Iterator[str]:
    """An object that was scanned."""
    mask = settings.get("mask")
    if mask is not None and not Path(mask).is_file():
        yield f"{where}.mask: {mask}: no such file; give the path of a NIfTI image"
    if {"labels", "materials"} <= set(settings):
        wrong = look_once(settings, [settings["labels"]], lambda: _labels(settings), keep)
        yield from (f"{where}: {line}" for line in wrong)
    if "kind" in settings:
        from ...physics.scenes.objects import read_object  # loads numba, for those who get here

        wrong = _said(read_object, settings["kind"], settings.get("parameters"))
        yield from (f"{where}: {line}" for line in wrong)


def _labels(settings: Mapping) -> list[str]:
    from ...physics.scenes.labeled import read_label_map  # loads numba, for those who get here

    return _said(read_label_map, settings["labels"], settings["materials"])


def _proof(config: dict) -> Iterator[str]:
    yield from _said(Proof.read, Plan(config), Files(config["results_dir"]))
