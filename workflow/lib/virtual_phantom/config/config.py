"""Check the configuration of a study, with one line per error, and complete it with defaults."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..base.console import note
from ..base.errors import InputError, InputErrors
from ..base.geometry import with_beam
from ..base.home import expand_home
from ..base.settings import from_mapping
from ..io.published import FOLDER, OLD_FOLDER, resources_folder
from ..io.schema import SCHEMA, check_nesting, fill_defaults, mistakes, read_schema
from ..physics.beam.material_names import library_name
from ..physics.effect import acts_on_images, checked
from ..proof.scoring.registration import seed_of
from .config_rules import Names, Rules
from .outputs import Files
from .plan import without_physics
from .public_scans import made_folders
from .read_config import REMOVABLE, section_at
from .settings import Study

# Sections whose keys are names chosen by the user.
NAMED = (("protocols",), ("noise", "levels"), ("scans",), ("diagnosis", "recordings"))
NAMED += (("analyses", "pca"), ("analyses", "comparison"))


def check(settings: Mapping) -> dict:
    """Return a checked copy of a configuration with the schema's defaults.

    Parameters
    ----------
    settings : mapping
        Configuration without defaults. Null removes a key of a protocol or of one of these sections: `protocols`,
        `noise.levels`, `scans`, `recordings`, `public_scans`, `analyses`, `analyses.pca`, `analyses.comparison`,
        `diagnosis.recordings`, `diagnosis.scanners`. A configuration can thus remove entries of the files before it.

    Raises
    ------
    InputErrors
        For values that the schema refuses, for unknown or unsuitable names, and for contradicting sections.
    """
    lines, config = inspect_config(settings)
    if lines:
        raise InputErrors(lines)
    return config


def read_study(settings: Mapping) -> Study:
    """Return the complete configuration as dataclasses.

    `check` describes the settings, which are not changed, and the errors.
    """
    study = from_mapping(Study, complete(settings))
    if study.analyses.stability and study.analyses.stability.without_physics:
        study = replace(study, protocols=study.protocols | without_physics(study.protocols))
    return study


def complete(settings: Mapping) -> dict:
    """Return the complete configuration, with all defaults of the schema and all parameters of effects.

    `check` describes the settings, which are not changed, and the errors.
    """
    config = check(settings)
    for protocol in config["protocols"].values():
        physics = protocol.get("physics", config["physics"])
        if "from" in physics:
            protocol |= {"physics": {}, "physics_from": physics["from"]}
        elif physics:
            effects = checked(physics)
            protocol["physics"] = {key: value for key, value in effects.items() if not acts_on_images(key)}
            protocol["image_physics"] = {key: value for key, value in effects.items() if acts_on_images(key)}
    return config


def _without_nulls(settings: Mapping) -> dict:
    """Return a copy without the keys that null removes."""
    config = copy.deepcopy(dict(settings))
    for path in (*REMOVABLE, *(("protocols", name) for name in section_at(config, "protocols"))):
        section = section_at(config, *path)
        for key in [key for key, value in section.items() if value is None]:
            del section[key]
    return config


def _name_labels(config: dict) -> None:
    """Convert labels of label maps to text like all other keys; YAML reads them as whole numbers."""
    for recording in section_at(config, "diagnosis", "recordings").values():
        if materials := section_at(recording, "object", "materials"):
            recording["object"]["materials"] = {str(k) if type(k) is int else k: name for k, name in materials.items()}


def _name_materials(config: dict) -> None:
    """Replace alternative names of materials by the library's names."""
    sections = [(section_at(config, "materials"), ("soft", "dense"))]
    for recording in section_at(config, "diagnosis", "recordings").values():
        sections += [(section_at(recording, key), ("material",)) for key in ("disc", "object")]
    for section, keys in sections:
        section |= {key: library_name(section[key]) for key in keys if key in section}


def _replace_attribute(config: dict) -> None:
    """Replace the deprecated key `analyses.comparison.*.attribute` by `diagnosis.comparisons`."""
    for name, comparison in section_at(config, "analyses", "comparison").items():
        if not isinstance(comparison, dict) or type(comparison.get("attribute")) is not bool:
            continue
        diagnosis = config.setdefault("diagnosis", {})
        if comparison.pop("attribute") and isinstance(diagnosis, dict):
            where = f"config: analyses.comparison.{name}.attribute is deprecated"
            note(f"{where}; name {name} in diagnosis.comparisons and run `snakemake diagnosis`")
            named = diagnosis.setdefault("comparisons", [])
            if isinstance(named, list) and name not in named:
                diagnosis["comparisons"] = [*named, name]


def _find_resources(config: dict) -> None:
    """Find files of the CT below `resources`, or below its former name `downloads`, whichever folder exists."""
    if (folder := resources_folder()) == OLD_FOLDER:
        note(f"{OLD_FOLDER}: this folder is named {FOLDER} now; rename it, as the next release does not look into it")
    ct = section_at(config, "phantom", "ct")
    rois = [roi for roi in ct.get("rois") or () if isinstance(roi, dict)] if isinstance(ct.get("rois"), list) else []
    for where, section, key in (("", ct, "image"), ("", ct, "labels"), *(("rois.", roi, "file") for roi in rois)):
        path = section.get(key)
        if not isinstance(path, str) or Path(path).exists():
            continue
        first, _, rest = path.partition("/")
        if rest and first in {FOLDER, OLD_FOLDER} - {folder}:
            section[key] = f"{folder}/{rest}"
            if first == OLD_FOLDER:
                note(f"config: phantom.ct.{where}{key} is deprecated below {OLD_FOLDER}; write {section[key]}")


def inspect_config(settings: Mapping) -> tuple[list[str], dict]:
    """Return all errors of a configuration and its valid part.

    `check` describes the settings, which are not changed.

    Returns
    -------
    lines : list of str
        One line for each error.
    rest : dict
        Configuration with the schema's defaults, without the sections, list entries and values that the schema refuses.
    """
    try:
        check_nesting(settings, "config")
        settings = expand_home(settings)
    except InputError as error:
        return [str(error)], {}
    config, schema = _without_nulls(settings), read_schema(SCHEMA)
    _name_labels(config)
    _name_materials(config)
    _replace_attribute(config)
    _find_resources(config)
    found, rest = mistakes(config, schema, "config", NAMED)
    # Named scans replace keys of the default scan. Their own defaults would overwrite its other keys.
    scans = rest.pop("scans", {})
    fill_defaults(rest, schema)
    _take_public_scans(rest)
    stability, noise = rest["analyses"].get("stability", {}), rest.get("noise", {})
    if isinstance(stability.get("noise"), str):
        stability["noise"] = [stability["noise"]]
    for level in noise.get("levels", {}).values():
        if "photons" in level and "A" not in level and noise.get("model") == "physical":
            level["A"] = 1 / level.pop("photons")
    rest["scans"] = {}
    if "scan" in rest:
        rest["scans"] = {name: with_beam(rest["scan"] | changes) for name, changes in scans.items()}
        rest["scan"] = with_beam(rest["scan"])
    lines = [mistake.line for mistake in found] + list(Rules(rest, Names(settings)).lines())
    try:
        rest["proof"]["seed"] = seed_of(rest["proof"]["seed"])
    except InputError as error:  # without a seed, there are no cases to check
        return [*dict.fromkeys(lines), str(error)], {}
    return list(dict.fromkeys(lines)), rest


def _take_public_scans(config: dict) -> None:
    """Fill in the files that are made from public scans: the image and labels of a CT, and folders of recordings."""
    results = config["results_dir"].rstrip("/")
    made, folders = Files(results), made_folders(results)
    config["recordings"] = {name: folders.get(folder, folder) for name, folder in config["recordings"].items()}
    scans, ct = config["public_scans"], config.get("phantom", {}).get("ct")
    if ct is None or not {"phantom", "compared"} & set(scans) or "image" in ct:
        return
    if "phantom" in scans:
        image = "sharp_scan" if scans["own_blur"] == "removed" else "mean_scan"
        ct |= {"image": made(image), "labels": made("mean_regions")}
    numbers = {region: number for number, region in enumerate(scans["regions"], start=1)}
    ct["rois"] = [{**roi, "label": numbers.get(roi.get("label"), roi.get("label"))} for roi in ct["rois"]]
