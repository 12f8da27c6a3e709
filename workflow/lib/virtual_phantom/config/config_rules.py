"""Check rules between keys of a configuration: references to existing names, required numbers, consistent sections.

Each rule is a generator of error lines. Invalid sections have been removed before, so rules skip missing sections.
Rules read mappings, not the dataclasses of settings.py, because they run before a configuration is complete.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from ..base.errors import InputError, did_you_mean
from ..base.geometry import PARALLEL
from ..base.names import same_but_for_case
from ..base.vectors import FLAT
from ..features.variations import FACTORS, UNRESAMPLED
from ..physics.effect import DIVERGENT_BEAM, check_readings, checked, effects_needing, image_effects
from ..statistics import COMPARED_REPEATS, MINIMUM_REPEATS, RANKSUM_REPEATS
from .outputs import OUTPUTS, WILDCARD
from .plan import WITHOUT_PHYSICS
from .read_config import section_at

PHYSICAL = "physical"  # model of noise with photons


@dataclass(frozen=True)
class Entries(Collection):
    """Names of the entries of a section.

    Attributes
    ----------
    path : str
        Keys of the section, joined by dots.
    removed : frozenset of str
        Entries that null removes.
    """

    path: str
    names: tuple[str, ...] = ()
    removed: frozenset[str] = frozenset()

    @classmethod
    def of(cls, settings: object, *path: str) -> Entries:
        """Return the entries at a path of keys."""
        section = section_at(settings, *path)
        removed = frozenset(str(key) for key, value in section.items() if value is None)
        return cls(".".join(path), tuple(str(key) for key in section if str(key) not in removed), removed)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)


class Names:
    """Names in an unchecked configuration, including names of invalid entries."""

    def __init__(self, settings: Mapping):
        self.protocols = Entries.of(settings, "protocols")
        self.levels = Entries.of(settings, "noise", "levels")
        self.scans = Entries.of(settings, "scans")
        self.recordings = Entries.of(settings, "recordings")
        self.diagnosed = Entries.of(settings, "diagnosis", "recordings")
        self.scanners = Entries.of(settings, "diagnosis", "scanners")
        self.comparisons = Entries.of(settings, "analyses", "comparison")
        self.quality = Entries.of(settings, "image_quality")
        self.phantom = Entries.of(settings, "phantom")


class Rules:
    """All rules for one configuration.

    Parameters
    ----------
    config : dict
        Configuration with defaults, without the parts that the schema refuses.
    names : Names
        Names in the whole configuration.
    """

    def __init__(self, config: dict, names: Names):
        self.config, self.names = config, names
        self.levels: dict = config.get("noise", {}).get("levels", {})
        self.protocols: dict = config.get("protocols", {})
        self.grouped = {name: protocol for name, protocol in self.protocols.items() if "group" in protocol}
        self.analyses: dict = config["analyses"]

    def lines(self) -> Iterator[str]:
        """Yield one line for each error."""
        for rule in (
            self._case,
            self._files,
            self._levels,
            self._repositioned,
            self._protocols,
            self._voxels,
            self._stability,
            self._restricted,
            self._extraction,
            self._optimal,
            self._noise_calibration,
            self._physics,
            self._parallel,
            self._matched,
            self._comparisons,
            self._diagnosed,
            self._diagnosed_comparisons,
            self._further_recordings,
            self._image_quality,
            self._components,
            self._phantom,
            self._scans,
            self._measured,
        ):
            yield from rule()

    # Helpers

    def _known(self, name: str, section: Collection[str], where: str, *more: Entries) -> Iterator[str]:
        """Yield a line if a name is in none of the sections."""
        sections = (section, *more)
        if any(name in entries for entries in sections):
            return
        choices = [other for entries in sections for other in entries]
        if nulls := [entries for entries in sections if isinstance(entries, Entries) and name in entries.removed]:
            yield (
                f"config: {where} names '{name}', which {nulls[0].path}.{name}: null removes; remove it or name "
                f"another: {', '.join(choices) or 'none is left'}"
            )
        else:
            yield f"config: {where} names '{name}', which does not exist; {did_you_mean(name, choices)}"

    def _other_recording(self, name: str, other: str, key: str) -> Iterator[str]:
        """Yield a line if the key of a diagnosed recording names no other diagnosed recording."""
        if other == name or other not in self.names.diagnosed:
            others = ", ".join(sorted(set(self.config["diagnosis"]["recordings"]) - {name})) or "none"
            removed = f", which diagnosis.recordings.{other}: null removes" * (other in self.names.diagnosed.removed)
            yield (
                f"config: diagnosis.recordings.{name}.{key} is '{other}'{removed}; name another diagnosed recording: "
                f"{others}"
            )

    def _of_algorithm(self, name: str, algorithm: str, where: str) -> Iterator[str]:
        """Check that a protocol has an algorithm; FBP with a noise kernel counts as iterative (sirt) too."""
        yield from self._known(name, self.names.protocols, where)
        protocol = self.protocols.get(name, {})
        actual = protocol.get("algorithm", algorithm)
        if actual != algorithm and not (algorithm == "sirt" and "noise_kernel" in protocol):
            yield (
                f"config: {where} names '{name}', whose algorithm is {actual}; name a protocol of algorithm {algorithm}"
            )

    def _repeated(self, level: str, least: int, reason: str) -> Iterator[str]:
        repeats = self.levels.get(level, {}).get("repeats", least)
        if repeats < least:
            yield f"config: noise.levels.{level}.repeats is {repeats}; {reason}"

    # Rules

    def _case(self) -> Iterator[str]:
        """Check that names in file names differ in more than case."""
        names = self.names
        for section in (
            names.protocols,
            names.levels,
            names.scans,
            names.recordings,
            names.diagnosed,
            names.scanners,
            names.comparisons,
            names.quality,
        ):
            if alike := same_but_for_case(section):
                yield f"config: {section.path}: {alike[0]} and {alike[1]} differ only in case; rename one of them"

    def _files(self) -> Iterator[str]:
        """Check that recordings, scanners and comparisons write different files, and not into folders of each other."""
        names, compared = self.names, self.config["diagnosis"]["comparisons"]
        written: list[tuple[str, Entries, str]] = []
        for output in OUTPUTS:
            wildcards = WILDCARD.findall(output.pattern)
            section = {
                ("recording",): names.diagnosed if output.pattern.startswith("diagnosis/") else names.recordings,
                ("scanner",): names.scanners,
                ("comparison",): names.comparisons,
            }.get(tuple(wildcards), ())
            for name in section:
                if output.rule != "diagnose_features" or name in compared:
                    written += [(path, section, name) for path in output.paths(**{wildcards[0]: name})]
        owners = {path: (section, name) for path, section, name in written}
        for path, section, name in written:
            for known in (path, *map(str, PurePosixPath(path).parents)):
                other, others_name = owners.get(known, (section, name))
                if others_name != name:  # equal names are checked by _diagnosed_comparisons
                    both = sorted((f"{other.path}.{others_name}", f"{section.path}.{name}"))
                    yield f"config: {both[0]} and {both[1]} both write to {known}; rename one of them"
                    return

    def _levels(self) -> Iterator[str]:
        for name, level in self.levels.items():
            if len({"A", "photons", "meets"} & set(level)) != 1:
                yield f"config: noise.levels.{name}: give either photons, A or meets"
            elif "photons" in level:
                yield f"config: noise.levels.{name}.photons needs noise.model: physical; give A instead"

    def _repositioned(self) -> Iterator[str]:
        """Check that re-positioning has a motion, and that analyses of voxels have enough repeats without it."""
        moved = self.config["repeats"]
        if not moved["repositioned"]:
            return
        if self.config.get("phantom", {}).get("source") == "object":
            yield "config: repeats.repositioned is for phantom.source synthetic or ct, not object; remove it"
        if not moved["shift_mm"] and not moved["turn_deg"]:
            yield "config: repeats.repositioned moves nothing without shift_mm or turn_deg; give one of them"
        uses = dict.fromkeys(self.analyses.get("noise_calibration", {}).get("noise", []), "analyses.noise_calibration")
        if "optimal" in self.analyses:
            uses[self.analyses["optimal"]["noise"]] = "analyses.optimal"
        least = {"analyses.noise_calibration": MINIMUM_REPEATS, "analyses.optimal": 1}
        for name, comparison in self._changed_images():
            uses[comparison["noise"]] = where = f"diagnosis.comparisons ({name})"
            least[where] = COMPARED_REPEATS
        for level, where in uses.items():
            repeats = self.levels.get(level, {}).get("repeats", least[where] + moved["repositioned"])
            if repeats - moved["repositioned"] < least[where]:
                yield (
                    f"config: repeats.repositioned is {moved['repositioned']}, and noise.levels.{level} has {repeats} "
                    f"repeats; {where} compares voxels and needs at least {least[where]} repeats that are not "
                    "re-positioned, so give more"
                )

    def _protocols(self) -> Iterator[str]:
        for name, protocol in self.protocols.items():
            if "scan" in protocol:
                yield from self._known(protocol["scan"], self.names.scans, f"protocols.{name}.scan")
            for level in protocol.get("noise", ()):
                yield from self._known(level, self.names.levels, f"protocols.{name}.noise")
        groups: dict[int, str] = {}
        for name, protocol in self.grouped.items():
            if (other := groups.setdefault(protocol["group"], name)) != name:
                yield (
                    f"config: protocols.{other} and protocols.{name} have the same group number, {protocol['group']}; "
                    "give each its own"
                )

    def _voxels(self) -> Iterator[str]:
        """Check that kernels and scanner voxels are used with filtered back-projection, and for features only."""
        normalise = self.config["reconstruction"]["fbp"]["normalise"]
        for name, protocol in self.protocols.items():
            for key in ("job", "kernel", "noise_kernel", "voxels"):
                where = f"config: protocols.{name}.{key}"
                if key in protocol and protocol["algorithm"] != "fbp":
                    yield f"{where} is for algorithm fbp, and this protocol's is {protocol['algorithm']}; remove it"
                elif key in protocol and key != "job" and normalise != "coverage":
                    yield f"{where} needs reconstruction.fbp.normalise: coverage"
            for key in ("kernel", "noise_kernel"):
                kernel = protocol.get(key)
                if kernel and kernel["mtf50_per_cm"] >= kernel["mtf10_per_cm"]:
                    yield (
                        f"config: protocols.{name}.{key}: mtf50_per_cm is {kernel['mtf50_per_cm']:g}, mtf10_per_cm is "
                        f"{kernel['mtf10_per_cm']:g}; the first must be less than the second"
                    )
            if "noise_kernel" in protocol and "kernel" not in protocol:
                yield f"config: protocols.{name}.noise_kernel needs kernel; add it or remove noise_kernel"
            stated = protocol.get("physics", self.config["physics"]) if "voxels" in protocol else {}
            if of_images := stated and set(stated) & set(image_effects()):
                yield (
                    f"config: protocols.{name}.voxels: its images are boxes around ROIs, and {min(of_images)} acts on "
                    "whole images; remove one of them"
                )
        boxed = {name for name, protocol in self.protocols.items() if "voxels" in protocol}
        if boxed and self.config.get("phantom", {}).get("source") == "object":
            yield f"config: protocols.{min(boxed)}.voxels is for phantom.source synthetic or ct; remove it"
        optimal = self.analyses.get("optimal", {})
        users = {f"analyses.optimal.{key}": optimal.get(key) for key in ("fbp", "sirt")}
        for name, comparison in self._changed_images():
            users[f"diagnosis.comparisons ({name})"] = comparison["protocol"]
        for name, settings in self.config["diagnosis"]["recordings"].items():
            users[f"diagnosis.recordings.{name}.protocol"] = settings.get("protocol")
        for path in self.config["dicom"]["images"]:
            users[f"dicom.images ({path})"] = path.partition("/")[0]
        for where, name in users.items():
            if name in boxed:
                yield (
                    f"config: {where} names '{name}', whose images are boxes around ROIs; name a protocol without "
                    "voxels"
                )

    def _levels_of(self, name: str, levels: Collection[str]) -> Collection[str]:
        """Return the noise levels of a protocol, `levels` by default or if it names one that does not exist."""
        own = self.protocols.get(name, {}).get("noise", levels)
        return own if all(level in self.names.levels for level in own) else levels

    def _stability(self) -> Iterator[str]:
        if "stability" not in self.analyses:
            return
        levels = self.analyses["stability"]["noise"]
        reason = f"analyses.stability needs at least {RANKSUM_REPEATS} for a rank-sum test"
        for noise in levels:
            yield from self._known(noise, self.names.levels, "analyses.stability.noise")
            yield from self._repeated(noise, RANKSUM_REPEATS, reason)
        for name in self.grouped:
            if not set(self._levels_of(name, levels)) & set(levels):
                yield (
                    f"config: protocols.{name}.noise has none of the levels of analyses.stability.noise, "
                    f"{', '.join(levels)}; add one of them, or remove the group of {name}"
                )
        invalid = set(self.names.protocols) - set(self.protocols)
        if not self.grouped and not invalid:
            yield "config: analyses.stability needs a protocol with a group number, better several; add group to them"
        if self.analyses["stability"]["without_physics"] and not invalid:
            if len(self.grouped) == 1:
                yield "config: analyses.stability.without_physics needs at least two protocols with a group; remove it"
            if not any(protocol.get("physics", self.config["physics"]) for protocol in self.grouped.values()):
                where = "config: analyses.stability.without_physics"
                yield f"{where}: no protocol with a group has physics; add physics, or remove this key"
            for name in self.grouped:
                if name + WITHOUT_PHYSICS in self.protocols:
                    yield (
                        f"config: protocols.{name}{WITHOUT_PHYSICS}: analyses.stability.without_physics makes a "
                        f"protocol of this name from {name}; rename it"
                    )

        if self.analyses["stability"]["noise_control"]:
            reason = f"analyses.stability.noise_control needs at least {MINIMUM_REPEATS} for the variance"
            for noise in levels:
                yield from self._repeated(noise, MINIMUM_REPEATS, reason)
            for name, protocol in self.grouped.items():
                if protocol.get("voxels"):
                    yield (
                        f"config: analyses.stability.noise_control: protocol {name} has its own voxels; remove "
                        "noise_control, or voxels from all protocols with a group"
                    )

    def _restricted(self) -> Iterator[str]:
        """Check that analyses name no noise level that `protocols.*.noise` excludes."""
        uses = []
        if optimal := self.analyses.get("optimal"):
            uses.append(("analyses.optimal", [optimal["sirt"], optimal["fbp"]], [optimal["noise"]]))
        if calibration := self.analyses.get("noise_calibration"):
            uses.append(("analyses.noise_calibration", calibration["protocols"], calibration["noise"]))
        for name, selection in self.analyses.get("pca", {}).items():
            uses.append((f"analyses.pca.{name}", selection["protocols"], selection["noise"]))
        for name, comparison in self.analyses.get("comparison", {}).items():
            uses.append((f"analyses.comparison.{name}", [comparison["protocol"]], [comparison["noise"]]))
        for where, protocols, levels in uses:
            for name in protocols:
                own = self._levels_of(name, levels)
                if missing := [level for level in levels if level in self.names.levels and level not in own]:
                    yield f"config: {where} needs protocols.{name} at {missing[0]}; add {missing[0]} to its noise"

    def _extraction(self) -> Iterator[str]:
        if (axis := self.analyses.get("extraction")) is None:
            return
        where = "analyses.extraction"
        if not set(axis) & set(FACTORS):
            yield f"config: {where} varies no setting; give one of {', '.join(FACTORS)}"
        if text := [value for value in axis.get("resampled_mm", ()) if isinstance(value, str) and value != UNRESAMPLED]:
            yield f"config: {where}.resampled_mm holds '{text[0]}'; give lengths in mm or {UNRESAMPLED}"
        levels = axis.get("noise", self.analyses.get("stability", {}).get("noise", []))
        protocols = axis.get("protocols", list(self.grouped))
        for key, names in (("protocols", protocols), ("noise", levels)):
            if not names:
                yield f"config: {where}.{key} is missing; without analyses.stability and groups, name some"
        for name in protocols:
            yield from self._known(name, self.names.protocols, f"{where}.protocols")
        reason = f"{where} needs at least {RANKSUM_REPEATS} for a rank-sum test"
        for level in levels:
            yield from self._known(level, self.names.levels, f"{where}.noise")
            yield from self._repeated(level, RANKSUM_REPEATS, reason)
        for name in protocols:
            protocol = self.protocols.get(name, {})
            if levels and not set(self._levels_of(name, levels)) & set(levels):
                yield f"config: protocols.{name}.noise has none of the levels of {where}, {', '.join(levels)}; add one"
            spacing = protocol.get("voxels", {}).get("spacing_mm") or self.config.get("grid", {}).get("spacing_mm")
            lengths = [value for value in axis.get("resampled_mm", ()) if not isinstance(value, str)]
            if spacing and lengths and min(lengths) < min(spacing):
                yield (
                    f"config: {where}.resampled_mm holds {min(lengths):g}, less than every voxel side of protocol "
                    f"{name}; give at least {min(spacing):g} mm, since interpolation adds no detail"
                )
                return

    def _optimal(self) -> Iterator[str]:
        if "optimal" in self.analyses:
            yield from self._known(self.analyses["optimal"]["noise"], self.names.levels, "analyses.optimal.noise")
            for algorithm in ("sirt", "fbp"):
                name = self.analyses["optimal"][algorithm]
                yield from self._of_algorithm(name, algorithm, f"analyses.optimal.{algorithm}")

    def _noise_calibration(self) -> Iterator[str]:
        if "noise_calibration" not in self.analyses:
            return
        calibration = self.analyses["noise_calibration"]
        for name in calibration["protocols"]:
            yield from self._known(name, self.names.protocols, "analyses.noise_calibration.protocols")
        for level in calibration["noise"]:
            yield from self._known(level, self.names.levels, "analyses.noise_calibration.noise")
            reason = f"the noise calibration needs at least {MINIMUM_REPEATS} to measure a variance"
            yield from self._repeated(level, MINIMUM_REPEATS, reason)
            if "meets" in self.levels.get(level, {}) and "A" not in self.levels[level]:
                yield (
                    f"config: analyses.noise_calibration.noise names '{level}', whose A depends on the calibration; "
                    "name levels that have an A"
                )
        values = [self.levels.get(level, {}).get("A") for level in calibration["noise"]]
        if None not in values and len(set(values)) < 2:
            yield (
                "config: analyses.noise_calibration.noise names levels with the same A; the fit of a line needs two "
                "different values"
            )

    @property
    def _has_photons(self) -> bool:
        """Whether the noise model has photons; a missing section has its own error."""
        return self.config.get("noise", {"model": PHYSICAL})["model"] == PHYSICAL

    def _physics(self) -> Iterator[str]:
        """Check effects and parameters once for each different `physics`, because many protocols share it."""
        seen = []
        for name, protocol in self.protocols.items():
            stated = protocol.get("physics", self.config["physics"])
            if not stated or stated in seen:
                continue
            seen.append(stated)
            where = f"config: protocols.{name}.physics"
            if not self._has_photons:
                yield f"{where} needs noise.model: {PHYSICAL}; the astra model has no photons"
                continue
            if "from" in stated:
                yield from self._physics_from(stated, where)
                continue
            for effect, parameters in stated.items():
                try:
                    physics = checked({effect: parameters}, where)
                    for label, level in self.levels.items():
                        if "A" in level:
                            check_readings(physics, 1 / level["A"], where, f"noise level {label}")
                except InputError as error:
                    yield str(error)

    def _parallel(self) -> Iterator[str]:
        """Check that effects of the focal spot are used with a divergent beam only."""
        for name, protocol in self.protocols.items():
            scan = self.config["scans"].get(protocol["scan"]) if protocol.get("scan") else self.config.get("scan")
            if (scan or {}).get("beam") == PARALLEL:
                for effect in sorted(
                    set(protocol.get("physics", self.config["physics"])) & set(effects_needing(DIVERGENT_BEAM))
                ):
                    yield f"config: protocols.{name}.physics: {effect} needs a focal spot; the scan's beam is parallel"

    def _physics_from(self, stated: dict, where: str) -> Iterator[str]:
        name, effects = stated["from"], sorted(set(stated) - {"from"})
        if effects:
            yield f"{where} has from and {effects[0]}; keep one of them"
        if name in self.names.diagnosed and name in self.names.scanners:
            yield f"{where}.from is '{name}', a recording and a scanner under diagnosis; rename one of them"
        yield from self._known(name, self.names.diagnosed, f"{where.split(': ')[1]}.from", self.names.scanners)

    def _matched(self) -> Iterator[str]:
        calibrated = self.analyses.get("noise_calibration", {}).get("protocols", [])
        for name, level in self.levels.items():
            if "meets" in level:
                where = f"noise.levels.{name}.meets.recording"
                yield from self._known(level["meets"]["recording"], self.names.recordings, where)
                if level["meets"]["protocol"] not in calibrated:
                    yield (
                        f"config: noise.levels.{name}.meets.protocol is '{level['meets']['protocol']}', which is not "
                        "in the noise calibration; add it to analyses.noise_calibration.protocols"
                    )

    def _comparisons(self) -> Iterator[str]:
        for name, comparison in self.analyses.get("comparison", {}).items():
            where = f"analyses.comparison.{name}"
            yield from self._known(comparison["recording"], self.names.recordings, f"{where}.recording")
            yield from self._known(comparison["protocol"], self.names.protocols, f"{where}.protocol")
            yield from self._known(comparison["noise"], self.names.levels, f"{where}.noise")
            reason = f"{where} needs at least {COMPARED_REPEATS} for an SD"
            yield from self._repeated(comparison["noise"], COMPARED_REPEATS, reason)

    def _diagnosed(self) -> Iterator[str]:
        """Check diagnosis.recordings and diagnosis.scanners."""
        diagnosed = self.config["diagnosis"]["recordings"]
        for name, settings in diagnosed.items():
            yield from self._known(name, self.names.recordings, "diagnosis.recordings")
            yield from self._diagnosed_recording(name, settings, diagnosed)
            if "protocol" in settings:
                where = f"diagnosis.recordings.{name}.protocol"
                yield from self._known(settings["protocol"], self.names.protocols, where)

        for name, scanner in self.config["diagnosis"]["scanners"].items():
            where = f"diagnosis.scanners.{name}.recordings"
            for recording in scanner["recordings"]:
                yield from self._known(recording, self.names.diagnosed, where)
                if diagnosed.get(recording, {}).get("object", {}).get("unknown"):
                    yield f"config: {where} names '{recording}', whose object is unknown; remove it"
                for key in ("physics_from", "baseline_from"):
                    if other := diagnosed.get(recording, {}).get(key):
                        yield f"config: {where} names '{recording}', which has {key}: {other}; remove that key"
            yield from self._judged_of_scanner(name, scanner)
            yield from self._protocols_of_scanner(name, scanner)

    def _judged_of_scanner(self, name: str, scanner: dict) -> Iterator[str]:
        where = f"diagnosis.scanners.{name}.test_recordings"
        for recording in scanner["test_recordings"]:
            yield from self._known(recording, scanner["recordings"], where)
        if len(set(scanner["recordings"]) - set(scanner["test_recordings"])) < 2:
            yield f"config: {where} leaves fewer than two recordings for the selection of effects; remove some from it"

    def _protocols_of_scanner(self, name: str, scanner: dict) -> Iterator[str]:
        where, seen = f"diagnosis.scanners.{name}.protocols", {}
        for protocol, recordings in scanner["protocols"].items():
            for recording in recordings:
                yield from self._known(recording, scanner["recordings"], f"{where}.{protocol}")
                if recording in seen:
                    yield f"config: {where}: '{recording}' is in {seen[recording]} and in {protocol}; keep one of them"
                seen[recording] = protocol

    def _diagnosed_recording(self, name: str, settings: dict, diagnosed: dict) -> Iterator[str]:
        where = f"config: diagnosis.recordings.{name}"
        if len(given := [key for key in ("disc", "object", "simulation") if key in settings]) > 1:
            yield f"{where} has both {given[0]} and {given[1]}; keep the one that was scanned"
        if "simulation_energy_kev" in settings and "simulation" not in settings:
            yield f"{where}.simulation_energy_kev: there is no simulation; add it, or remove this key"
        yield from self._object(settings.get("object", {"kind": ""}), f"{where}.object")
        fitted = [key for key in ("baseline", "baseline_from", "effects", "physics_from") if settings.get(key)]
        if settings.get("object", {}).get("unknown") and fitted:
            yield f"{where} has an unknown object, so that {fitted[0]} has no meaning; remove one of them"
        if "baseline_from" in settings:
            other = settings["baseline_from"]
            if "physics_from" in settings:
                yield f"{where} has both physics_from and baseline_from; keep one of them"
            if unknown := list(self._other_recording(name, other, "baseline_from")):
                yield from unknown
            elif keys := {"physics_from", "baseline_from"} & set(diagnosed.get(other, {})):
                yield f"{where}.baseline_from is '{other}', which has {min(keys)}; name the recording given there"
        if "physics_from" in settings:
            other = settings["physics_from"]
            if unknown := list(self._other_recording(name, other, "physics_from")):
                yield from unknown
            elif "physics_from" in diagnosed.get(other, {}):
                yield f"{where}.physics_from is '{other}', which has physics_from; name the recording given there"
            elif "effects" in settings:
                yield f"{where} has both effects and physics_from; the effects come from '{other}', so remove effects"

    def _object(self, settings: dict, where: str) -> Iterator[str]:
        """Check that an object is a mask with its material, a label map with its materials, shapes or a scan."""
        masked, labeled, shaped, scanned, unknown = (
            set(keys) & set(settings)
            for keys in (("mask", "material"), ("labels", "materials"), ("kind", "parameters"), ("scan",), ("unknown",))
        )
        both = [min(keys) for keys in (masked, labeled, shaped, scanned, unknown) if keys]
        if len(both) > 1:
            yield (
                f"{where} has both {both[0]} and {both[1]}; keep mask and material, labels and materials, or kind and "
                "parameters"
            )
        elif not {"kind", "scan", "unknown"} & set(settings) and 2 not in (len(masked), len(labeled)):
            yield (
                f"{where} needs kind (an object of shapes), mask and material, or labels and materials; or scan; or "
                "unknown"
            )

    def _changed_images(self) -> Iterator[tuple[str, dict]]:
        """Yield name and settings of each comparison under diagnosis, whose job changes images voxel by voxel."""
        for name, comparison in self.analyses.get("comparison", {}).items():
            if name in self.config["diagnosis"]["comparisons"]:
                yield name, comparison

    def _diagnosed_comparisons(self) -> Iterator[str]:
        for name in self.config["diagnosis"]["comparisons"]:
            yield from self._known(name, self.names.comparisons, "diagnosis.comparisons")
            if name in self.names.diagnosed:
                yield (
                    f"config: diagnosis.comparisons and diagnosis.recordings both have '{name}', and would write to "
                    "the same folder; rename the comparison"
                )

    def _image_quality(self) -> Iterator[str]:
        for name, quality in self.config.get("image_quality", {}).items():
            for recording in quality["recordings"]:
                yield from self._known(recording, self.names.recordings, f"image_quality.{name}.recordings")

    def _further_recordings(self) -> Iterator[str]:
        for name in self.analyses.get("stability", {}).get("recordings", []):
            yield from self._known(name, self.names.recordings, "analyses.stability.recordings")

    def _components(self) -> Iterator[str]:
        for figure, selection in self.analyses.get("pca", {}).items():
            for name in selection["recordings"]:
                yield from self._known(name, self.names.recordings, f"analyses.pca.{figure}.recordings")
            for name in selection["protocols"]:
                where = f"analyses.pca.{figure}.protocols"
                if figure == "multicentre":
                    yield from self._known(name, self.names.protocols, where)
                else:
                    yield from self._of_algorithm(name, figure, where)
            for level in selection["noise"]:
                yield from self._known(level, self.names.levels, f"analyses.pca.{figure}.noise")

    def _phantom(self) -> Iterator[str]:
        phantom = self.config.get("phantom", {})
        if phantom.get("source") == "object" and "object" not in self.names.phantom:
            yield "config: phantom.source is object, but phantom.object is missing; give it a kind"
        if phantom.get("source") == "ct" and "ct" not in self.names.phantom:
            yield "config: phantom.source is ct, but phantom.ct is missing; give it an image and rois"
        elif phantom.get("source") == "ct" and "ct" in phantom and "image" not in phantom["ct"]:
            yield "config: phantom.ct.image is missing; name a CT, or public scans under public_scans.phantom"
        elif "phantom" in self.config["public_scans"] and phantom.get("source") == "ct":
            yield from self._regions(phantom.get("ct", {}).get("rois", []))
        elif "compared" in self.config["public_scans"] and "image" not in phantom.get("ct", {}):
            yield from self._regions(phantom.get("ct", {}).get("rois", []))

    def _regions(self, rois: list[dict]) -> Iterator[str]:
        """Check labels of regions of public scans. `config.inspect_config` has replaced known names by numbers."""
        regions = self.config["public_scans"]["regions"]
        for roi in rois:
            label = roi.get("label")
            if isinstance(label, str) or label is None or label > len(regions):
                yield (
                    f"config: phantom.ct.rois: {roi['name']} has the label {label}, which is not in "
                    f"public_scans.regions; {did_you_mean(str(label), map(str, regions))}"
                )

    def _scans(self) -> Iterator[str]:
        scans = {"scan": self.config["scan"]} if "scan" in self.config else {}
        scans |= {f"scans.{name}": scan for name, scan in self.config["scans"].items()}
        for name, scan in scans.items():
            # Counts of the astra model are relative to the largest line integral, not to the air of a pixel.
            if scan.get("samples", 1) > 1 and not self._has_photons:
                yield f"config: {name}.samples needs noise.model: {PHYSICAL}; the astra model has no photons"
            if scan.get("beam") == PARALLEL:
                if scan.get("detector", FLAT) != FLAT or scan.get("flying_focal_spot"):
                    yield f"config: {name}.beam is parallel; remove {name}.detector and {name}.flying_focal_spot"
                continue
            if scan["source_to_detector_mm"] <= scan["source_to_isocentre_mm"]:
                yield f"config: {name}.source_to_detector_mm must be larger than source_to_isocentre_mm"
            if scan.get("arc_radius_mm") is not None and scan.get("detector", FLAT) == FLAT:
                yield f"config: {name}.arc_radius_mm is for a cylindrical detector; set {name}.detector: cylindrical"

    def _measured(self) -> Iterator[str]:
        """Check that measured data come with the printed phantom, and that components have the data that they need."""
        phantom = self.config.get("phantom", {})
        if not self.config["measured"]["overlay"]:
            for figure, selection in self.analyses.get("pca", {}).items():
                if selection["fit_on"] != "simulated" and not selection["recordings"]:
                    yield (
                        f"config: analyses.pca.{figure}.fit_on is {selection['fit_on']}, but measured.overlay is "
                        "false; set fit_on: simulated"
                    )
        elif phantom.get("source") == "object":
            yield (
                "config: measured.overlay needs the ROIs of the printed phantom, and phantom.source is object; "
                "set measured.overlay: false"
            )
        elif phantom.get("source") == "ct" and "ct" in phantom:
            # Imported here, because the import takes a second and every start of the workflow reads the configuration.
            from ..phantom.rois import read_roi_entries
            from ..statistics.measured import TISSUE_CLASSES

            settings = phantom["ct"]
            try:
                entries = read_roi_entries(settings["rois"], settings.get("labels"))
            except InputError:  # reported by the checks of the phantom's files
                return
            names = {name for entry in entries for name in entry.names}
            for verb, wrong in (("also has", names - set(TISSUE_CLASSES)), ("lacks", set(TISSUE_CLASSES) - names)):
                if wrong:
                    yield (
                        f"config: measured.overlay needs exactly the ROIs {', '.join(TISSUE_CLASSES)}, and "
                        f"phantom.ct.rois {verb} {', '.join(sorted(wrong)[:3])}; set measured.overlay: false"
                    )
                    return
