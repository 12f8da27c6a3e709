"""Write docs/physics.md, the catalogue of effects, from the library."""

import math
from pathlib import Path

from virtual_phantom.base.names import label
from virtual_phantom.physics.effect import (
    OF_AIR,
    OF_AIR_PER_SCAN,
    PER_AIR_PHOTON,
    PER_SCAN,
    PER_VIEW,
    STAGES,
    Parameter,
    load,
    names,
)

ROOT = Path(__file__).resolve().parents[1]

TARGET = ROOT / "docs" / "physics.md"

INTRODUCTION = """# The acquisition chain and its effects

The baseline is [the paper's](https://doi.org/10.1038/s41598-022-08301-1): one energy, a point source, an ideal
detector, Poisson noise, the logarithm. What it leaves out are effects. An effect is off until it is switched on, for
all protocols or for one:

```yaml
noise: {model: physical} # the paper's formula, with photons to act on; the default, astra, has none
physics:
  scatter: {amount: 0.05}
protocols:
  sirt_300: {physics: {spectrum: {kvp: 100}, electronic_noise: }} # no scatter here: it replaces the common physics
```

`physics: {from: bench}` takes the effects [that a diagnosis found](diagnosis.md#what-does-it-change-in-my-features).

Each effect begins with its key and its stage. Its parameters follow with their **typical value** (which one left out
has), plausible range, the value at which the effect is off, and what a fit of one scan keeps to.

* **Order** of stages: STAGES. Those of the image act after the
  reconstruction; `snakemake diagnosis` tries the others on projections ([how](diagnosis.md)).
* **Geometry.** Rays run to where the pixels of a turned detector are, flat or curved. Bowtie, heel and off-focal
  radiation keep to the stated one: 10 degrees off the central ray, 1 degree of tilt or skew changes angles by 0.3 %.
* **Not there**: scatter has one kernel and does not know of depth.
* **Baseline.** A study without effects does not use this chain, but one path length in one material; they agree to
  2e-5.
* **Materials.** A voxel is divided among two materials by its HU (`materials`), exactly at the energy where water
  attenuates `mu_water_per_mm`. Attenuation comes from xraylib, spectra from SpekPy.
* **Sensor** (`sensor`, `nominal.sensor` of a recording). Photons, and their noise, are weighed by the energy that they
  leave in its layer (with K escape and Compton scattering) or counted. 1/A are a pixel's noise-equivalent quanta.
* **Units carry over** to scans at another speed, dose or collimation, but for the amount of scatter, which falls with
  the height of the beam. A dark signal is in photons per pixel in a study; of line integrals and images, in shares of
  the mean signal in air.
* **Time.** View i of N is exposed in the middle of its interval dt, at t_i = (i + 1/2 - N/2) dt; dt is
  `scan.rotation_time_ms` over the views of a turn.
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
    lines = [f"## {heading(name)}", "", f"`{name}`, {label(effect.stage)}. {effect.physics}", ""]
    lines += [f"* {_parameter(one)}" for one in effect.parameters]
    lines += [f"* **Equation**: {effect.equation}", f"* **Source**: {effect.source}"]
    lines += [f"* **Told apart by**: {effect.signature}", f"* **Settled by**: {effect.settled_by}"]
    return "\n".join(lines)


def _parameter(one: Parameter) -> str:
    unit = "" if one.unit in ("1", "number") else f" {one.unit}"
    off = "" if one.neutral is None else f"; off at {one.neutral:g}"
    line = f"`{one.name}`: {one.meaning}, **{one.typical:g}{unit}** ({_range(one.low, one.high)}{off})"
    if one.reach is not None:
        line += f"; in a fit {_range(one.reach.low, one.reach.high)} {WORDS[one.reach.of]}"
    return line


def _range(low: float, high: float) -> str:
    return "any" if math.isinf(high) else f"{low:g} to {high:g}"


def page() -> str:
    order = sorted(names(), key=lambda name: STAGES.index(load(name).stage))
    stages = ", ".join(map(label, STAGES))
    return "\n\n".join([INTRODUCTION.replace("STAGES", stages).rstrip(), *map(section, order)]) + "\n"


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
