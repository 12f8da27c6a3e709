"""Pairs of settings of a study that differ in one kind of change, found from the configuration and never from names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

from ..base.names import label
from ..config.plan import Plan
from ..config.settings import Protocol
from ..features.variations import OWN
from ..statistics import ANY_PROTOCOL, EXTRACTION, REPEATS, REPOSITIONING

DOSE, PROJECTIONS, SLICES, PIXELS = "dose", "projections", "slice thickness", "pixel size"
PROTOCOL_AND_DOSE = "protocol and dose"
RECONSTRUCTION, KERNEL, SCANNER, PHYSICS = "reconstruction", "kernel", "scanner", "physics"


@dataclass(frozen=True)
class Setting:
    """Images of one setting.

    Attributes
    ----------
    label : str
        Name for readers.
    where : dict
        {column of the feature table: value} of its rows.
    seeds : tuple of int
        Its repeats.
    """

    label: str
    where: dict
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class SettingPair:
    """Two settings to compare; `relation` as in `statistics.changes.Change`."""

    kind: str
    first: Setting
    second: Setting
    relation: str


def setting_pairs(plan: Plan) -> tuple[SettingPair, ...]:
    """Return all pairs of settings of the stability analysis that differ in one kind of change.

    Also included: every setting with itself (random repeats) and with its re-positioned repeats. ANY_PROTOCOL has all
    pairs of protocols at the noise level of the analysis, with all repeats, as in the tables of W.
    """
    if plan.study.analyses.stability is None:
        return ()
    groups = plan.groups()
    images = [(protocol, noise) for protocol, noise in plan.acquisitions_with_features() if protocol in groups]
    images.sort(key=lambda image: (list(groups).index(image[0]), _dose_order(plan, image[1])))
    return (*_repeats(plan, images), *_single_changes(plan, images), *_both(plan), *_protocols(plan))


def _repeats(plan: Plan, images: list[tuple[str, str]]) -> Iterator[SettingPair]:
    for protocol, noise in images:
        nominal, moved = plan.nominal_seeds(noise), plan.repositioned_seeds(noise)
        if len(_seeds(plan, noise)) > 1:
            one = _setting(protocol, noise, _seeds(plan, noise), f"{protocol}, {noise}")
            # Re-positioned repeats differ in position too, also from one another.
            yield SettingPair(REPEATS if nominal else REPOSITIONING, one, one, "repeats")
        if nominal and moved:
            labels = {"nominal position": nominal, "re-positioned": moved}
            ends = (_setting(protocol, noise, seeds, label) for label, seeds in labels.items())
            yield SettingPair(REPOSITIONING, *ends, "independent")


def _single_changes(plan: Plan, images: list[tuple[str, str]]) -> Iterator[SettingPair]:
    for first, second in combinations(images, 2):
        kinds = _differences(plan, first, second)
        if len(kinds) != 1:
            continue
        labels = [_label(plan, kinds[0], *image) for image in (first, second)]
        if labels[0] == labels[1]:
            labels = [f"{protocol}, {noise}" for protocol, noise in (first, second)]
        yield SettingPair(
            kinds[0],
            *(
                _setting(*image, _seeds(plan, image[1]), label)
                for image, label in zip((first, second), labels, strict=True)
            ),
            # Without another noise level, repeats with the same seed have the same start angle and may share noise.
            "paired" if first[1] == second[1] else "independent",
        )


def _protocols(plan: Plan) -> Iterator[SettingPair]:
    levels = plan.compared_levels()
    for first, second in combinations(plan.groups(), 2):
        settings = (_setting(name, levels[name], plan.seeds(levels[name]), name) for name in (first, second))
        yield SettingPair(ANY_PROTOCOL, *settings, "paired" if levels[first] == levels[second] else "independent")


def _both(plan: Plan) -> Iterator[SettingPair]:
    """Yield the pairs of protocols with different noise levels, if the stability analysis has several levels."""
    levels = plan.study.analyses.stability.noise
    compared = set(plan.compared_levels().items()) if len(set(plan.compared_levels().values())) > 1 else set()
    images = [(protocol, noise) for protocol in plan.groups() for noise in plan.levels_of(protocol, levels)]
    for first, second in combinations(images, 2):
        if first[0] != second[0] and first[1] != second[1] and not {first, second} <= compared:
            settings = (_setting(*image, _seeds(plan, image[1]), ", ".join(image)) for image in (first, second))
            yield SettingPair(PROTOCOL_AND_DOSE, *settings, "independent")


def extraction_pairs(plan: Plan) -> tuple[SettingPair, ...]:
    """Return the pairs of values of one extraction setting on the same images; the study's own value is one of them.

    The column setting of the table of all settings (`statistics.extraction_settings.long_table`) has their names.
    """
    factors: dict[str, list[str]] = {}
    for name, variation in plan.variations.items():
        factors.setdefault(variation.factor, [OWN]).append(name)
    seeds = tuple(range(plan.extracted_repeats())) if factors else ()
    return tuple(
        SettingPair(
            EXTRACTION,
            *(
                Setting(label(name), {"protocol": protocol, "noise": noise, "setting": name}, seeds)
                for name in (first, second)
            ),
            "paired",
        )
        for protocol, noise in plan.extracted_images()
        for names in factors.values()
        for first, second in combinations(names, 2)
    )


def _seeds(plan: Plan, noise: str) -> list[str]:
    """Return the repeats at the nominal position; all, if every repeat is re-positioned."""
    return plan.nominal_seeds(noise) or plan.seeds(noise)


def _setting(protocol: str, noise: str, seeds: list[str], label: str) -> Setting:
    return Setting(label, {"protocol": protocol, "noise": noise}, tuple(int(seed) for seed in seeds))


def _differences(plan: Plan, first: tuple[str, str], second: tuple[str, str]) -> list[str]:
    """Return the kinds of change between two (protocol, noise level)."""
    one, other = _settings(plan, *first), _settings(plan, *second)
    kinds = [kind for kind in one if one[kind] != other[kind]]
    if one[RECONSTRUCTION][0] != other[RECONSTRUCTION][0] and KERNEL in kinds:
        kinds.remove(KERNEL)  # only FBP has a kernel
    return kinds


def _settings(plan: Plan, protocol: str, noise: str) -> dict[str, object]:
    """Return {kind of change: settings that it concerns}."""
    one = plan.study.protocols[protocol]
    level = plan.study.noise.levels[noise]
    spacing, thickness = _voxels(plan, one)
    return {
        DOSE: (level.A, level.meets),
        PROJECTIONS: one.projections,
        SCANNER: plan.scan_of(protocol),
        RECONSTRUCTION: (one.algorithm, one.noise_kernel),
        KERNEL: one.kernel,
        SLICES: (spacing[0], thickness),
        PIXELS: spacing[1:],
        PHYSICS: (one.physics, one.image_physics, one.physics_from),
    }


def _voxels(plan: Plan, protocol: Protocol) -> tuple[tuple[float, ...], float]:
    """Return voxel size (z, y, x) and slice thickness, mm."""
    if protocol.voxels:
        return tuple(protocol.voxels.spacing_mm), protocol.voxels.thickness_mm
    spacing = tuple(plan.study.grid.spacing_mm)
    return spacing, spacing[0]


def _label(plan: Plan, kind: str, protocol: str, noise: str) -> str:
    """Return a setting in words."""
    one = plan.study.protocols[protocol]
    spacing, thickness = _voxels(plan, one)
    labels = {
        DOSE: noise,
        PROJECTIONS: f"{one.projections} projections",
        RECONSTRUCTION: one.reconstruction,
        SLICES: f"{thickness:g} mm",
        PIXELS: f"{spacing[-1]:g} mm",
        SCANNER: one.scan or "scan",
    }
    if kind == KERNEL and one.kernel:
        return f"{one.kernel.mtf50_per_cm:g}/cm (MTF 50 %)"
    return labels.get(kind, protocol)


def _dose_order(plan: Plan, noise: str) -> tuple[float, int]:
    """Sort key of noise levels: highest dose first; matched levels, whose A is not yet known, last."""
    levels = plan.study.noise.levels
    level = levels[noise].A
    return (float("inf") if level is None else level, list(levels).index(noise))
