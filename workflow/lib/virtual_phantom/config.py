"""The study's configuration: checked against its schema, defaults filled in, mistakes told in one line."""

from __future__ import annotations

import copy
import math
from functools import cache
from pathlib import Path

import yaml
from jsonschema import Draft202012Validator, validators
from jsonschema.exceptions import best_match

from .errors import InputError, meant
from .physics.effect import acts_on_images, check_readings, checked
from .statistics import COMPARED_REPEATS, MINIMUM_REPEATS, RANKSUM_REPEATS

SCHEMA = Path(__file__).resolve().parents[2] / "schemas" / "config.schema.yaml"
DEEPEST, MOST_ITEMS = 40, 100_000  # levels and items of a document
# Python's types are not JSON's: range() takes no 150.0, and callers hand in points as tuples.
_Validator = validators.extend(
    Draft202012Validator,
    type_checker=Draft202012Validator.TYPE_CHECKER.redefine_many(
        {
            "integer": lambda _, value: isinstance(value, int) and not isinstance(value, bool),
            "array": lambda _, value: isinstance(value, list | tuple),
        }
    ),
)

BOUNDS = {"minimum": "at least", "exclusiveMinimum": "more than", "maximum": "at most", "exclusiveMaximum": "less than"}


def check(config: dict, schema_path: str | Path) -> dict:
    """A complete configuration from the user's.

    Keys set to null in `protocols` and in each protocol, `noise.levels`, `scans`, `recordings`, `analyses`,
    `analyses.pca` or `analyses.comparison` are dropped, which lets an overlay take away what the file under it has.
    Raises InputError, naming the key, for anything that the schema refuses, for names that point nowhere or to what
    does not fit, and for sections that contradict one another.
    """
    schema = _read_schema(Path(schema_path))
    check_nesting(config, "config")
    config = _without_nulls(copy.deepcopy(dict(config)))
    validate(config, schema, "config")
    _fill_defaults(config, schema)
    _check_names(config)
    _check_measured(config)
    return config


def validate(document: dict, schema: dict, source: str) -> None:
    """Raise InputError, one line that begins with `source` and names the key, for what the schema refuses.

    Keys that are not text, which YAML makes of 1 or yes, are refused too.
    """
    check_nesting(document, source)
    _check_keys(document, (), source)
    error = best_match(_Validator(schema).iter_errors(document), key=_depth_first)
    if error is not None:
        raise InputError(_one_line(error, source))


def check_nesting(document, source: str) -> None:
    """Raise InputError for a document that is too deep or too large to be meant: YAML's aliases make one of a few lines
    that unfolds to billions of items, or holds itself."""
    waiting, seen = [(document, 0)], 0
    while waiting:
        value, depth = waiting.pop()
        seen += 1
        if depth > DEEPEST or seen > MOST_ITEMS:
            raise InputError(f"{source}: is nested too deeply or unfolds to too many items; leave out aliases")
        if isinstance(value, dict):
            waiting += [(item, depth + 1) for item in value.values()]
        elif isinstance(value, list | tuple):
            waiting += [(item, depth + 1) for item in value]


@cache
def schema_of(*section: str) -> dict:
    """The schema of a section of the configuration, given by its keys, as `validate` takes it."""
    whole = part = _read_schema(SCHEMA)
    for key in section:
        part = part["properties"][key]
    return {**part, "$defs": whole["$defs"]}


def defaults_of(*section: str) -> dict:
    """What the schema has by default in a section of the configuration, given by its keys."""
    document: dict = {}
    fill_defaults(document, schema_of(*section))
    return document


def fill_defaults(document: dict, schema: dict) -> None:
    """Add to a valid document, in place, every key that it leaves out and the schema has a default for."""
    for _ in _with_defaults(Draft202012Validator)(schema).iter_errors(document):
        pass


@cache
def _read_schema(path: Path) -> dict:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def _without_nulls(config):
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


def _check_keys(value, path, source):
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise InputError(
                    f"{source}: the key {key} in {_where(path, source)} is not text to YAML; correct it, or put it in "
                    "quotes if it is a name"
                )
    elif not isinstance(value, list | tuple):
        return
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        _check_keys(item, (*path, key), source)


def _where(path, source):
    return ".".join(map(str, path)) or Path(source).name


def _depth_first(error):
    return -len(error.absolute_path), error.validator not in ("additionalProperties", "required")


def _one_line(error, source):
    where = _where(error.absolute_path, source)
    if error.validator == "additionalProperties":
        known = list(error.schema.get("properties", ()))
        unknown = sorted(set(error.instance) - set(known), key=str)[0]
        return f"{source}: unknown key '{unknown}' in {where}; {meant(unknown, known, 'known keys')}"
    if error.validator == "enum":
        choices = ", ".join(str(value) for value in error.validator_value)
        return f"{source}: {where} is '{error.instance}'; use one of {choices}"
    if error.validator == "pattern" and "title" in error.schema:
        return f"{source}: {where}: {error.instance!r} must be of {error.schema['title']}"
    if error.validator == "type" and (number := _number_meant(error.instance, error.validator_value)):
        kind = "text" if isinstance(error.instance, str) else "not a whole number"
        return f"{source}: {where}: {error.instance!r} is {kind} to YAML; write {number}"
    what = error.schema.get("description", "") if isinstance(error.schema, dict) else ""
    message = " ".join(error.message.split())
    if error.validator == "minItems":
        message = f"has {len(error.instance)} entries; give at least {error.validator_value}"
    elif error.validator in BOUNDS:
        message += f"; give {BOUNDS[error.validator]} {error.validator_value:g}"
    place = source if where == source else f"{source}: {where}"
    return f"{place}: {message[:300]}" + (f" ({what})" if what else "")


def _number_meant(value, kinds) -> str | None:
    """How YAML 1.1, which asks for a point and a signed exponent, writes the number that a value reads as, if one."""
    kinds = [kinds] if isinstance(kinds, str) else kinds
    try:
        number = float(value) if isinstance(value, str | float) else math.nan
    except ValueError:
        return None
    if "number" in kinds and math.isfinite(number):
        mantissa, exponential, exponent = value.strip().lower().partition("e")
        if not exponential:
            return mantissa
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}"
    return str(int(number)) if "integer" in kinds and number.is_integer() else None


def _with_defaults(validator_class):
    def set_defaults(validator, properties, instance, schema):
        if isinstance(instance, dict):
            for key, sub in properties.items():
                if "default" in sub:
                    instance.setdefault(key, copy.deepcopy(sub["default"]))
        yield from validator_class.VALIDATORS["properties"](validator, properties, instance, schema)

    return validators.extend(validator_class, {"properties": set_defaults})


def _fill_defaults(config, schema):
    # The named scans replace keys of the default one: their own defaults would undo it.
    scans = config.pop("scans", {})
    fill_defaults(config, schema)
    config["scans"] = {name: {**config["scan"], **changes} for name, changes in scans.items()}


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
    """Effects and their parameters, completed in place."""
    for name, settings in config["protocols"].items():
        if "physics" not in settings and config["physics"]:
            settings["physics"] = config["physics"]
        if not settings.get("physics"):
            continue
        if config["noise"]["model"] != "physical":
            raise InputError(
                f"config: protocols.{name}.physics needs noise.model: physical; the astra model has no photons"
            )
        physics = checked(settings["physics"], f"config: protocols.{name}.physics")
        for label, level in config["noise"]["levels"].items():
            if "A" in level:
                check_readings(physics, 1 / level["A"], f"config: protocols.{name}.physics", f"noise level {label}")
        settings["physics"] = {key: values for key, values in physics.items() if not acts_on_images(key)}
        settings["image_physics"] = {key: values for key, values in physics.items() if acts_on_images(key)}


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
        from .measured import TISSUE_CLASSES
        from .phantom.rois import read_entries

        settings = config["phantom"]["ct"]
        names = {name for entry in read_entries(settings["rois"], settings.get("labels")) for name in entry.names}
        for verb, odd in (("gives", names - set(TISSUE_CLASSES)), ("lacks", set(TISSUE_CLASSES) - names)):
            if odd:
                raise InputError(
                    f"config: measured.overlay is for the ROIs {', '.join(TISSUE_CLASSES)} alone, and phantom.ct.rois "
                    f"{verb} {', '.join(sorted(odd)[:3])}; set measured.overlay: false"
                )
