"""The study's configuration: checked, mistakes told in one line, and then completed with its defaults."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping

from ..base.errors import InputError, meant
from ..io.schema import SCHEMA, check_nesting, fill_defaults, read_schema, validate
from ..physics.effect import acts_on_images, check_readings, checked
from ..statistics import COMPARED_REPEATS, MINIMUM_REPEATS, RANKSUM_REPEATS


def check(settings: Mapping) -> None:
    """Say what is wrong with a configuration, and change nothing.

    Parameters
    ----------
    settings : mapping
        The user's, without defaults. Keys set to null in `protocols` and in each protocol, `noise.levels`, `scans`,
        `recordings`, `analyses`, `analyses.pca` or `analyses.comparison` are as if they were not there, which lets an
        overlay take away what the file under it has.

    Raises
    ------
    InputError
        Naming the key, for anything that the schema refuses, for names that point nowhere or to what does not fit, and
        for sections that contradict one another.
    """
    _checked(settings)


def complete(settings: Mapping) -> dict:
    """The whole configuration: every key that the schema has a default for, and effects with all their parameters.

    Parameters
    ----------
    settings : mapping
        As `check` takes them; they stay as they are.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        As `check` does.
    """
    config = _checked(settings)
    for name, physics in _physics(config):
        effects = checked(physics)
        config["protocols"][name]["physics"] = {key: of for key, of in effects.items() if not acts_on_images(key)}
        config["protocols"][name]["image_physics"] = {key: of for key, of in effects.items() if acts_on_images(key)}
    return config


def _without_nulls(settings: Mapping) -> dict:
    """A copy without the keys that are taken away."""
    config = copy.deepcopy(dict(settings))
    paths = [("protocols",), ("noise", "levels"), ("analyses",), ("analyses", "pca"), ("scans",), ("recordings",)]
    paths.append(("analyses", "comparison"))
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


def _checked(settings: Mapping) -> dict:
    """A copy that has been checked, with the schema's defaults."""
    check_nesting(settings, "config")
    config, schema = _without_nulls(settings), read_schema(SCHEMA)
    validate(config, schema, "config")
    # The named scans replace keys of the default one: their own defaults would undo it.
    scans = config.pop("scans", {})
    fill_defaults(config, schema)
    config["scans"] = {name: {**config["scan"], **changes} for name, changes in scans.items()}
    _check_names(config)
    _check_measured(config)
    return config


def _physics(config: dict) -> Iterator[tuple[str, dict]]:
    """(protocol, its effects as they are stated) of the protocols that have some."""
    for name, settings in config["protocols"].items():
        if physics := settings.get("physics", config["physics"]):
            yield name, physics


def _check_names(config):
    def known(name, section, where):
        if name not in section:
            raise InputError(f"config: {where} names '{name}', which is not there; {meant(name, section)}")

    def of_algorithm(name, algorithm, where):
        known(name, protocols, where)
        if (actual := protocols[name]["algorithm"]) != algorithm:
            raise InputError(
                f"config: {where} names '{name}', whose algorithm is {actual}; name a protocol of algorithm {algorithm}"
            )

    def repeated(level, least, reason):
        if (repeats := levels[level]["repeats"]) < least:
            raise InputError(f"config: noise.levels.{level}.repeats is {repeats}; {reason}")

    levels, protocols = config["noise"]["levels"], config["protocols"]
    for name, level in levels.items():
        if ("A" in level) == ("meets" in level):
            raise InputError(f"config: noise.levels.{name}: give it either A or meets")
    for name, protocol in protocols.items():
        if "scan" in protocol:
            known(protocol["scan"], config["scans"], f"protocols.{name}.scan")
    groups: dict[int, str] = {}
    for name, protocol in protocols.items():
        if "group" in protocol and (other := groups.setdefault(protocol["group"], name)) != name:
            raise InputError(
                f"config: protocols.{other} and protocols.{name} have the same group number, {protocol['group']}; "
                "give each its own"
            )
    analyses = config["analyses"]
    if "stability" in analyses:
        known(analyses["stability"]["noise"], levels, "analyses.stability.noise")
        repeated(
            analyses["stability"]["noise"],
            RANKSUM_REPEATS,
            f"analyses.stability needs at least {RANKSUM_REPEATS} for a rank-sum test",
        )
        if len(groups) < 2:
            raise InputError("config: analyses.stability needs at least two protocols with a group number")
    if "optimal" in analyses:
        known(analyses["optimal"]["noise"], levels, "analyses.optimal.noise")
        for algorithm in ("sirt", "fbp"):
            of_algorithm(analyses["optimal"][algorithm], algorithm, f"analyses.optimal.{algorithm}")
    if "noise_calibration" in analyses:
        for name in analyses["noise_calibration"]["protocols"]:
            known(name, protocols, "analyses.noise_calibration.protocols")
        for level in analyses["noise_calibration"]["noise"]:
            known(level, levels, "analyses.noise_calibration.noise")
            repeated(
                level, MINIMUM_REPEATS, f"the noise calibration needs at least {MINIMUM_REPEATS} to measure a variance"
            )
            if "A" not in levels[level]:
                raise InputError(
                    f"config: analyses.noise_calibration.noise names '{level}', whose A it is to find; name levels "
                    "that have an A"
                )
        if len({levels[level]["A"] for level in analyses["noise_calibration"]["noise"]}) < 2:
            raise InputError(
                "config: analyses.noise_calibration.noise names levels of one A only; give two different ones, as no "
                "line goes through one point"
            )
    _check_physics(config)
    calibrated = analyses.get("noise_calibration", {}).get("protocols", [])
    for name, level in levels.items():
        if "meets" in level:
            known(level["meets"]["recording"], config["recordings"], f"noise.levels.{name}.meets.recording")
            if level["meets"]["protocol"] not in calibrated:
                raise InputError(
                    f"config: noise.levels.{name}.meets.protocol is '{level['meets']['protocol']}', which the noise "
                    "calibration does not hold; add it to analyses.noise_calibration.protocols"
                )
    for name, comparison in analyses.get("comparison", {}).items():
        where = f"analyses.comparison.{name}"
        known(comparison["recording"], config["recordings"], f"{where}.recording")
        known(comparison["protocol"], protocols, f"{where}.protocol")
        known(comparison["noise"], levels, f"{where}.noise")
        repeated(comparison["noise"], COMPARED_REPEATS, f"{where} needs at least {COMPARED_REPEATS} for an SD")
    for name, settings in config["diagnosis"]["recordings"].items():
        known(name, config["recordings"], "diagnosis.recordings")
        _check_diagnosed(name, settings, config["diagnosis"]["recordings"])
        if "protocol" in settings:
            known(settings["protocol"], protocols, f"diagnosis.recordings.{name}.protocol")
    for name in config["diagnosis"]["comparisons"]:
        known(name, analyses.get("comparison", {}), "diagnosis.comparisons")
        if name in config["diagnosis"]["recordings"]:
            raise InputError(
                f"config: diagnosis.comparisons names '{name}', as diagnosis.recordings does; both would be written to "
                "one folder, so name the comparison otherwise"
            )
    for name in analyses.get("stability", {}).get("recordings", []):
        known(name, config["recordings"], "analyses.stability.recordings")
    for figure, selection in analyses.get("pca", {}).items():
        for name in selection["recordings"]:
            known(name, config["recordings"], f"analyses.pca.{figure}.recordings")
        for name in selection["protocols"]:
            where = f"analyses.pca.{figure}.protocols"
            known(name, protocols, where) if figure == "multicentre" else of_algorithm(name, figure, where)
        for level in selection["noise"]:
            known(level, levels, f"analyses.pca.{figure}.noise")
    if config["phantom"]["source"] == "ct" and "ct" not in config["phantom"]:
        raise InputError("config: phantom.source is ct, but phantom.ct is missing; give it an image and rois")
    for name, scan in {"scan": config["scan"], **{f"scans.{k}": v for k, v in config["scans"].items()}}.items():
        if scan["source_to_detector_mm"] <= scan["source_to_isocentre_mm"]:
            raise InputError(f"config: {name}.source_to_detector_mm must be larger than source_to_isocentre_mm")


def _check_diagnosed(name, settings, diagnosed):
    """One recording under diagnosis.recordings."""
    where = f"config: diagnosis.recordings.{name}"
    if "disc" in settings and "object" in settings:
        raise InputError(f"{where} has both disc and object; keep the one that was scanned")
    if "physics_from" not in settings:
        return
    other = settings["physics_from"]
    if other == name or other not in diagnosed:
        others = ", ".join(sorted(set(diagnosed) - {name})) or "none"
        raise InputError(f"{where}.physics_from is '{other}'; name another diagnosed recording: {others}")
    if "physics_from" in diagnosed[other]:
        raise InputError(f"{where}.physics_from is '{other}', which has its physics from elsewhere; name that one")
    if "effects" in settings:
        raise InputError(f"{where} has both effects and physics_from; effects are those of '{other}', remove effects")


def _check_physics(config):
    """Effects and their parameters."""
    for name, stated in _physics(config):
        where = f"config: protocols.{name}.physics"
        if config["noise"]["model"] != "physical":
            raise InputError(f"{where} needs noise.model: physical; the astra model has no photons")
        physics = checked(stated, where)
        for label, level in config["noise"]["levels"].items():
            if "A" in level:
                check_readings(physics, 1 / level["A"], where, f"noise level {label}")


def _check_measured(config):
    """Measured data need the printed phantom's ROIs, and components fitted on them need the data."""
    if not config["measured"]["overlay"]:
        for figure, selection in config["analyses"].get("pca", {}).items():
            if selection["fit_on"] != "simulated" and not selection["recordings"]:
                raise InputError(
                    f"config: analyses.pca.{figure}.fit_on is {selection['fit_on']}, but measured.overlay is false; "
                    "set fit_on: simulated"
                )
    elif config["phantom"]["source"] == "ct":
        # Here, because they take a second to load, and every start of the workflow reads the configuration.
        from ..phantom.rois import read_entries
        from ..statistics.measured import TISSUE_CLASSES

        settings = config["phantom"]["ct"]
        names = {name for entry in read_entries(settings["rois"], settings.get("labels")) for name in entry.names}
        for verb, odd in (("gives", names - set(TISSUE_CLASSES)), ("lacks", set(TISSUE_CLASSES) - names)):
            if odd:
                raise InputError(
                    f"config: measured.overlay is for the ROIs {', '.join(TISSUE_CLASSES)} alone, and phantom.ct.rois "
                    f"{verb} {', '.join(sorted(odd)[:3])}; set measured.overlay: false"
                )
