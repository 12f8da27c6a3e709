"""Find all errors of a study in its configuration and the files that it names, before anything is computed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

from ...base.errors import InputError, lines_of
from ...base.names import enumerated
from ...base.settings import from_mapping, to_mapping
from ...base.streams import Branch, branch
from ...config.config import inspect_config
from ...config.outputs import Files
from ...config.plan import Plan
from ...config.public_scans import PublicScans, made_folders
from ...config.read_config import section_at
from ...config.settings import Study
from ...diagnosis.candidate_effects import candidate_conditions, candidates, check_accuracy, check_kinds, is_of_images
from ...diagnosis.settings import LabelledObject, MaskedObject, OtherScan, ShapesObject
from ...projectors import choose_engine
from ...recordings.document import Document, files_of_recording, read_document
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
    lines, config = inspect_config(settings)
    if config:
        study = from_mapping(Study, config)
        phantom = partial(_phantom, keep=keep, rois=_number_of_rois(settings))
        recordings = partial(_recordings, keep=keep)
        for check in (_results, _engine, _layout, _shapes, phantom, _scans, _parameters, _measured, recordings, _proof):
            lines += check(study)
        if scans:
            lines += _scanned(study)
    return list(dict.fromkeys(lines))


def _messages(function, *arguments) -> list[str]:
    """Return a line for each mistake of the InputError that a function raises, if any."""
    try:
        function(*arguments)
    except InputError as error:
        return list(lines_of(error))
    return []


def _results(study: Study) -> Iterator[str]:
    folder = Path(study.results_dir)
    existing = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    if not existing.is_dir():
        yield f"results_dir: {existing} is a file; name a folder"
    elif not os.access(existing, os.W_OK):
        yield f"results_dir: {existing} is not writable; change its permissions or name another folder"


def _engine(study: Study) -> Iterator[str]:
    yield from _messages(partial(choose_engine, **study.engine_needs), study.engine)


def _layout(study: Study) -> Iterator[str]:
    """Check a user's layout of the synthetic phantom."""
    if _source(study) == "synthetic" and study.phantom.layout is not None:
        from ...phantom.layout import read_layout  # slow import

        yield from _messages(read_layout, study.phantom.layout)


def _shapes(study: Study) -> Iterator[str]:
    """Check a phantom of shapes."""
    if _source(study) == "object" and study.phantom.object:
        from ...physics.scenes.objects import read_phantom_object  # slow import (numba)

        yield from (f"phantom.object: {line}" for line in _messages(read_phantom_object, study.phantom.object))


def _seen_shapes(study: Study) -> Iterator[str]:
    """Check that scans cover a phantom of shapes."""
    if not study.grid or not study.phantom.object or list(_shapes(study)):
        return
    from ...physics.scenes.objects import read_phantom_object
    from ...physics.scenes.voxelized import reach_mm, voxelize_rois  # slow import
    from .preflight_scan import blind_spots, world_grid

    grid, (shaped, rois) = world_grid(study), read_phantom_object(study.phantom.object)
    try:
        masks = {roi.name: roi.mask for roi in voxelize_rois(shaped, grid, rois)}
    except InputError as error:
        yield str(error)
        return
    yield from blind_spots(study, grid, reach_mm(shaped), masks, math.hypot(*grid.spacing[1:]) / 2)


def _scanned(study: Study) -> Iterator[str]:
    """Check the files of recordings, and that scans cover the synthetic phantom or an available published CT."""
    yield from _recorded(study)
    source = _source(study)
    if source == "ct" and _has_ct(study):
        sources = PhantomSources(Plan(study))
        if sources.published and not sources.absent and not _messages(sources.check):
            yield from _ct(study)
    if source == "object":
        yield from _seen_shapes(study)
    if source != "synthetic" or not study.grid or list(_layout(study)):
        return
    from ...phantom.layout import read_layout
    from ...phantom.synthetic import find_outline  # slow import
    from .preflight_scan import blind_spots, world_grid

    grid = world_grid(study)
    try:
        reach, rois = find_outline(read_layout(study.phantom.layout), grid, branch(study.seed, Branch.PHANTOM))
    except InputError as error:
        yield str(error)
        return
    # `reach` is the edge of the shapes; the centers of voxels lie closer to the axis.
    slack = math.hypot(*grid.spacing[1:]) / 2
    yield from blind_spots(study, grid, reach, {roi.name: roi.mask for roi in rois}, slack)


def _source(study: Study) -> str | None:
    """Return the source of the phantom; None if the section has an error."""
    return study.phantom and study.phantom.source


def _has_ct(study: Study) -> bool:
    """Return whether the configuration has a valid CT and valid ROIs."""
    ct = study.phantom.ct
    return ct is not None and ct.image is not None and ct.rois is not None


def _number_of_rois(settings: Mapping) -> int:
    """Return the number of entries of phantom.ct.rois, including invalid ones."""
    rois = section_at(settings, "phantom", "ct").get("rois")
    return len(rois) if isinstance(rois, list) else 0


def _phantom(study: Study, keep: bool, rois: int) -> Iterator[str]:
    """Check a CT and its ROIs; `rois` is the number of entries before invalid ones were removed."""
    if _source(study) != "ct" or not _has_ct(study):
        return
    sources = PhantomSources(Plan(study))
    if damaged := _messages(sources.check):
        yield from damaged
    elif not sources.published and not sources.made:  # published files have a SHA-256; made files do not exist yet
        yield from cached_check(to_mapping(study), sources.paths, lambda: _ct(study), keep)


def _ct(study: Study) -> Iterator[str]:
    from .preflight_ct import ct_problems  # slow import

    yield from ct_problems(study)


def _parameters(study: Study) -> Iterator[str]:
    """Check the parameter file of features, and the settings that are compared with it."""
    if file := study.features and study.features.parameters:
        from ...features.parameters import read_parameters  # slow import (pyradiomics)

        try:
            parameters = read_parameters(file)
        except InputError as error:
            yield from lines_of(error)
            return
        used = {protocol for protocol, _ in Plan(study).acquisitions_with_features()}
        boxed = sorted(name for name in used if study.protocols[name].voxels is not None)
        if boxed and parameters.needs_whole_images:
            from ...features.extraction import whole_images_needed

            where = f"features.parameters: {whole_images_needed(parameters)}"
            yield f"{where}; remove them, or `voxels` of {enumerated(boxed)}"
    if study.features and study.analyses.extraction:
        if lines := _messages(lambda: Plan(study).variations):
            yield from lines
        elif not Plan(study).variations:
            yield (
                "config: analyses.extraction has only the settings of features; add a value that differs, or remove it"
            )


def _scans(study: Study) -> Iterator[str]:
    """Check the selected public scans."""
    yield from _messages(PublicScans(Plan(study)).check)


def _measured(study: Study) -> Iterator[str]:
    table = study.measured.table
    if table is not None and not Path(table).is_file():
        yield f"measured.table: {table}: no such file; give the path of the table, or null for the group means"


def _recordings(study: Study, keep: bool) -> Iterator[str]:
    """Check the documents of recordings and the settings of their diagnosis."""
    documents: dict[str, Document] = {}
    scans = PublicScans(Plan(study))
    for name, folder in study.recordings.items():
        try:
            documents[name] = scans.document(folder)
        except InputError as error:
            yield from lines_of(error)
    yield from roi_problems(study, documents)
    yield from _messages(check_accuracy, study.diagnosis.model_accuracy)
    for name, entry in study.diagnosis.recordings.items():
        where = f"diagnosis.recordings.{name}"
        yield from _object(entry.object, f"{where}.object", keep)
        if entry.simulation is not None and not Path(entry.simulation).exists():
            yield f"{where}.simulation: {entry.simulation}: does not exist; give an HDF5 file of projections, or images"
        if not {name, entry.physics_from or name} <= documents.keys():
            continue
        if lines := _messages(check_kinds, {name: entry}, documents):
            yield from lines
        elif entry.physics_from is None:
            lines = _messages(partial(candidates, **candidate_conditions(documents[name].content)), entry)
            yield from (f"{where}: {line}" for line in lines)
    for name, quality in study.image_quality.items():
        for recording in quality.recordings:
            if recording in documents and (kind := documents[recording].content["kind"]) != "images":
                where = f"image_quality.{name}.recordings: {recording}"
                yield f"{where} is a recording of {kind}; name recordings of images"
        for module, entry in quality.modules.items():
            yield from _object(entry.object, f"image_quality.{name}.modules.{module}.object", keep)


def _recorded(study: Study) -> Iterator[str]:
    """Check the data files of recordings."""
    made = made_folders(study.results).values()
    folders = [folder for folder in study.recordings.values() if folder not in made]
    if not folders:
        return
    from ...features.names import FEATURES
    from ...features.parameters import read_parameters  # slow import (pyradiomics)
    from ...recordings.reading import load_recording

    file, features = study.features and study.features.parameters, FEATURES
    if file and not _messages(read_parameters, file):
        features = read_parameters(file).features
    for folder in dict.fromkeys(folders):
        try:
            files = read_document(folder).files
        except InputError:  # reported by `_recordings`
            continue
        check = partial(_messages, load_recording, folder, features)
        yield from cached_check({"recording": folder, "features": list(features)}, files, check)
    for name, entry in study.diagnosis.recordings.items():
        folder = study.recordings.get(name)
        if entry.simulation is not None and Path(entry.simulation).exists() and folder in folders:
            check = partial(_messages, _simulation, entry.simulation, folder)
            yield from cached_check({"recording": folder}, [folder, entry.simulation], check)


def _simulation(path: str, folder: str) -> None:
    """Read a user's own simulation of a recording; `check_kinds` reports one of another kind."""
    from ...diagnosis.projections.own_simulation import read_simulation  # slow import
    from ...diagnosis.scanned_object import read_simulated_images
    from ...recordings.reading import load_recording

    if is_of_images(path):
        read_simulated_images(path)
    elif read_document(folder).content["kind"] == "projections":
        read_simulation(Path(path), load_recording(folder))


def _object(
    scanned: MaskedObject | LabelledObject | ShapesObject | OtherScan | None, where: str, keep: bool
) -> Iterator[str]:
    """Check the files of a scanned object."""
    if isinstance(scanned, MaskedObject):
        lines = cached_check(to_mapping(scanned), [scanned.mask], lambda: _mask(scanned), keep)
        yield from (f"{where}.mask: {line}" for line in lines)
    if isinstance(scanned, OtherScan) and not Path(scanned.scan).exists():
        yield f"{where}.scan: {scanned.scan}: does not exist; give a folder or an image in HU"
    elif isinstance(scanned, OtherScan):
        yield from _messages(files_of_recording, scanned.scan)
    if isinstance(scanned, LabelledObject):
        lines = cached_check(to_mapping(scanned), [scanned.labels], lambda: _labels(scanned), keep)
        yield from (f"{where}: {line}" for line in lines)
    if isinstance(scanned, ShapesObject):
        from ...physics.scenes.objects import read_object  # slow import (numba)

        lines = _messages(read_object, scanned.kind, scanned.parameters)
        yield from (f"{where}: {line}" for line in lines)


def _mask(scanned: MaskedObject) -> list[str]:
    from ...diagnosis.scanned_object import read_mask  # slow import (numba)

    return _messages(read_mask, scanned.mask)


def _labels(scanned: LabelledObject) -> list[str]:
    from ...physics.scenes.labeled import read_label_map  # slow import (numba)

    return _messages(read_label_map, scanned.labels, scanned.materials)


def _proof(study: Study) -> Iterator[str]:
    yield from _messages(Proof.read, Plan(study), Files(study.results))
