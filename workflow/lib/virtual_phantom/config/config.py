"""The study's configuration: checked, mistakes told in one line, and then completed with its defaults."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from pathlib import Path

from ..base.console import note
from ..base.errors import InputError, InputErrors
from ..base.geometry import PARALLEL, with_beam
from ..base.home import expand_home
from ..base.vectors import FLAT
from ..io.published import FOLDER, OLD_FOLDER, resources_folder
from ..io.schema import SCHEMA, check_nesting, fill_defaults, mistakes, read_schema
from ..physics.beam.material_names import library_name
from ..physics.effect import acts_on_images, checked
from .config_rules import Names, Rules
from .outputs import Files
from .plan import without_physics
from .public_scans import made_folders
from .read_config import REMOVABLE

# Sections of entries by names of the user's.
NAMED = (("protocols",), ("noise", "levels"), ("scans",), ("diagnosis", "recordings"))
NAMED += (("analyses", "pca"), ("analyses", "comparison"))


def check(settings: Mapping) -> None:
    """Say what is wrong with a configuration, and change nothing.

    Parameters
    ----------
    settings : mapping
        The user's, without defaults. Keys set to null in `protocols` and in each protocol, `noise.levels`, `scans`,
        `recordings`, `public_scans`, `analyses`, `analyses.pca`, `analyses.comparison`, `diagnosis.recordings` or
        `diagnosis.scanners` are as if they were not there, so that an overlay can remove what the file below it has.

    Raises
    ------
    InputErrors
        Naming the keys, for anything that the schema refuses, for names that point nowhere or to what does not fit, and
        for sections that contradict one another.
    """
    _checked(settings)


def flat_detectors(config: Mapping) -> bool:
    """Whether the detectors of all scans are flat, and their rays spread from a focal spot: what a GPU projects."""
    scans = (config.get("scan", {}), *config.get("scans", {}).values())
    return all(scan.get("detector", FLAT) == FLAT and scan.get("beam") != PARALLEL for scan in scans)


def complete(settings: Mapping) -> dict:
    """The whole configuration: every key that the schema has a default for, and effects with all their parameters.

    Parameters
    ----------
    settings : mapping
        As `check` takes them; they stay as they are.

    Raises
    ------
    InputErrors
        As `check` does.
    """
    config = _checked(settings)
    protocols = config["protocols"]
    for name, physics in _physics(config):
        if "from" in physics:
            protocols[name] |= {"physics": {}, "physics_from": physics["from"]}
            continue
        effects = checked(physics)
        protocols[name]["physics"] = {key: of for key, of in effects.items() if not acts_on_images(key)}
        protocols[name]["image_physics"] = {key: of for key, of in effects.items() if acts_on_images(key)}
    if config["analyses"].get("stability", {}).get("without_physics"):
        config["protocols"] = protocols | without_physics(protocols)
    return config


def _without_nulls(settings: Mapping) -> dict:
    """A copy without the keys that are taken away."""
    config = copy.deepcopy(dict(settings))
    paths: list[tuple[str, ...]] = list(REMOVABLE)
    if isinstance(config.get("protocols"), dict):
        paths += [("protocols", name) for name in config["protocols"]]
    for path in paths:
        section = config
        for key in path:
            section = section.get(key) if isinstance(section, dict) else None
        if isinstance(section, dict):
            for key in [key for key, value in section.items() if value is None]:
                del section[key]
    return config


def _section(config: object, *path: str) -> dict:
    """The section at a path of keys; an empty one where there is none, or something else."""
    for key in path:
        config = config.get(key) if isinstance(config, dict) else None
    return config if isinstance(config, dict) else {}


def _name_labels(config: dict) -> None:
    """Labels of label maps are whole numbers to YAML. Here they are text, as all keys."""
    for one in _section(config, "diagnosis", "recordings").values():
        if materials := _section(one, "object", "materials"):
            one["object"]["materials"] = {str(key) if type(key) is int else key: to for key, to in materials.items()}


def _name_materials(config: dict) -> None:
    """Materials by the library's names: from here on one material has one name."""
    places = [(_section(config, "materials"), ("soft", "dense"))]
    for one in _section(config, "diagnosis", "recordings").values():
        places += [(_section(one, key), ("material",)) for key in ("disc", "object")]
    for place, keys in places:
        place |= {key: library_name(place[key]) for key in keys if key in place}


def _replace_attribute(config: dict) -> None:
    """Replace the deprecated key `analyses.comparison.*.attribute` by `diagnosis.comparisons`."""
    for name, comparison in _section(config, "analyses", "comparison").items():
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
    """Read paths of the CT below `resources`, or below its former name `downloads`, in the folder that is there."""
    if (folder := resources_folder()) == OLD_FOLDER:
        note(f"{OLD_FOLDER}: this folder is named {FOLDER} now; rename it, as the next release does not look into it")
    ct = _section(config, "phantom", "ct")
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


def inspected(settings: Mapping) -> tuple[list[str], dict]:
    """All that is wrong with a configuration, and what is left of it without that.

    Parameters
    ----------
    settings : mapping
        As `check` takes them; they stay as they are.

    Returns
    -------
    lines : list of str
        One for each mistake.
    rest : dict
        The configuration with the schema's defaults, without sections, entries of lists or values that the schema
        refuses.
    """
    try:
        check_nesting(settings, "config")
        settings = expand_home(settings)
    except InputError as error:
        return [str(error)], {}
    whole, schema = _without_nulls(settings), read_schema(SCHEMA)
    _name_labels(whole)
    _name_materials(whole)
    _replace_attribute(whole)
    _find_resources(whole)
    found, rest = mistakes(whole, schema, "config", NAMED)
    # The named scans replace keys of the default one: their own defaults would undo it.
    scans = rest.pop("scans", {})
    fill_defaults(rest, schema)
    _take_public_scans(rest)
    rest["scans"] = {}
    if "scan" in rest:
        rest["scans"] = {name: with_beam({**rest["scan"], **changes}) for name, changes in scans.items()}
        rest["scan"] = with_beam(rest["scan"])
    lines = [mistake.line for mistake in found] + list(Rules(rest, Names.of(settings)).lines())
    return list(dict.fromkeys(lines)), rest


def _take_public_scans(config: dict) -> None:
    """A CT without an image is the mean of public scans, and its regions are theirs, by name; so is a recording."""
    made = Files(config["results_dir"].rstrip("/"))
    folders = made_folders(config)
    config["recordings"] = {name: folders.get(of, of) for name, of in config["recordings"].items()}
    scans, ct = config["public_scans"], config.get("phantom", {}).get("ct")
    if ct is None or not {"phantom", "compared"} & set(scans) or "image" in ct:
        return
    if "phantom" in scans:
        image = "sharp_scan" if scans["own_blur"] == "removed" else "mean_scan"
        ct |= {"image": made(image), "labels": made("mean_regions")}
    numbers = {region: number for number, region in enumerate(scans["regions"], start=1)}
    ct["rois"] = [{**roi, "label": numbers.get(roi.get("label"), roi.get("label"))} for roi in ct["rois"]]


def _checked(settings: Mapping) -> dict:
    """A copy that has been checked, with the schema's defaults."""
    lines, config = inspected(settings)
    if lines:
        raise InputErrors(lines)
    return config


def _physics(config: dict) -> Iterator[tuple[str, dict]]:
    """(protocol, its effects as they are stated) of the protocols that have some."""
    for name, settings in config["protocols"].items():
        if physics := settings.get("physics", config["physics"]):
            yield name, physics
