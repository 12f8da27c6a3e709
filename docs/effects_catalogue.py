"""Write docs/physics.md, the catalogue of effects, from the library."""

import math
from pathlib import Path

from virtual_phantom.base.words import label
from virtual_phantom.physics.effect import (
    OF_AIR,
    OF_AIR_PER_SCAN,
    PER_AIR_PHOTON,
    PER_SCAN,
    PER_VIEW,
    STAGES,
    load,
    names,
)

ROOT = Path(__file__).resolve().parents[1]

TARGET = ROOT / "docs" / "physics.md"

INTRODUCTION = """# The acquisition chain and its effects

The baseline is [the paper's](https://doi.org/10.1038/s41598-022-08301-1): one energy, a point source, an ideal
detector, Poisson noise, the logarithm. What it leaves out are effects. This page lists them, each with its
equation, source, parameters and what tells it apart, as `docs/effects_catalogue.py` reads them from
`workflow/lib/virtual_phantom/physics/effects`.

An effect is off until it is switched on, for all protocols or for one:

```yaml
noise: {model: physical} # the paper's formula, with photons to act on; the default, astra, has none
physics:
  scatter: {amount: 0.05}
protocols:
  sirt_300: {physics: {spectrum: {kvp: 100}, electronic_noise: }} # no scatter here: it replaces the common physics
```

A parameter that is left out has its typical value.

* **Order.** Effects act in this order: STAGES, those of one stage in the order of their names.
  Those of the stage image act after the reconstruction, which always
  goes by the stated geometry.
* **Diagnosis.** `snakemake diagnosis` tries all but those of the image on recordings of projections, the photon
  flux only if `nominal_photons` is given ([diagnosis.md](diagnosis.md)).
* **Not there yet**: scatter grids. Scatter has one kernel and does not know of depth.
* **Baseline.** Without effects the study does not use this chain, but one path length in one material. The chain at
  its baseline agrees with that to 2e-5, the rounding of its path lengths in single precision.
* **Materials.** A voxel is divided among two materials by its HU (`materials`). At the monochromatic energy, where
  water attenuates `mu_water_per_mm`, their amounts add up to the HU exactly. Attenuation comes from xraylib,
  spectra from SpekPy.
* **Sensor** (`sensor` of the configuration, `nominal.sensor` of a recording; `physics/sensors.py`). Photons are
  weighed by the energy that they leave in its layer, K escape and Compton scattering in it, or counted, and their
  noise with them. A pixel's photons, 1/A, are noise-equivalent quanta: 1 over the relative quantum variance in air.
* **Units carry over**: two scans of one scanner at another speed, dose or collimation have the same parameters, but
  for the amount of scatter, which falls with the height of the beam. A dark signal is in readout units: in a study,
  and in recordings of it, photons per pixel; of line integrals and images, which have none, the mean signal in air
  takes their place.
* **Time.** View i of N is exposed in the middle of its interval dt, at t_i = (i + 1/2 - N/2) dt from the middle of
  the scan; dt is `scan.rotation_time_ms` over the views of a turn.
"""


WORDS = {
    PER_VIEW: "times the time from view to view",
    PER_SCAN: "mm over the scan",
    OF_AIR: "times the reading in air",
    OF_AIR_PER_SCAN: "times the reading in air over the scan",
    PER_AIR_PHOTON: "over the photons of a pixel in air",
}


def heading(name: str) -> str:
    """An effect's name as a heading: hu_calibration is HU calibration."""
    words = label(name)
    return words[:1].upper() + words[1:]


def section(name: str) -> str:
    effect = load(name)
    lines = [f"## {heading(name)}", "", effect.physics, ""]
    lines += [f"* key: `{name}`, stage: {label(effect.stage)}"]
    lines += [f"* equation: {effect.equation}", f"* source: {effect.source}"]
    lines += [f"* told apart by: {effect.signature}", f"* settled by: {effect.settled_by}", ""]
    lines += ["| parameter | meaning | unit | typical | plausible | off at |", "|---|---|---|---|---|---|"]
    reaches: dict[str, list[str]] = {}
    for one in effect.parameters:
        off = "never" if one.neutral is None else f"{one.neutral:g}"
        lines.append(
            f"| `{one.name}` | {one.meaning} | {one.unit} | {one.typical:g} | {_range(one.low, one.high)} | {off} |"
        )
        if one.reach is not None:
            reach = f"{_range(one.reach.low, one.reach.high)} {WORDS[one.reach.of]}"
            reaches.setdefault(reach, []).append(f"`{one.name}`")
    if reaches:
        kept = "; ".join(f"{', '.join(names)} from {reach}" for reach, names in reaches.items())
        lines += ["", f"A fit of one scan keeps to {kept}."]
    return "\n".join(lines)


def _range(low: float, high: float) -> str:
    return "any" if math.isinf(high) else f"{low:g} to {high:g}"


def page() -> str:
    order = sorted(names(), key=lambda name: STAGES.index(load(name).stage))
    stages = ", ".join(map(label, STAGES))
    return "\n\n".join([INTRODUCTION.replace("STAGES", stages).rstrip(), *map(section, order)]) + "\n"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
