"""Page of the effects, from the library."""

import math

from virtual_phantom.base.names import label
from virtual_phantom.physics.effect import (
    OF_AIR,
    OF_AIR_PER_SCAN,
    PER_AIR_PHOTON,
    PER_PIXEL,
    PER_SCAN,
    PER_SCAN_SQUARED,
    PER_VIEW,
    STAGES,
    Parameter,
    load,
    names,
)

INTRODUCTION = """# Effects

The baseline is the model of [the paper](https://doi.org/10.1038/s41598-022-08301-1): one energy, a point source, an
ideal detector, Poisson noise and the logarithm. An effect adds physics to it. Switch effects on for all protocols or
for one:

```yaml
noise: {model: physical} # with a number of photons; the default, astra, is the formula of the paper
physics:
  scatter: {amount: 0.05}
protocols:
  sirt_300: {physics: {spectrum: {kvp: 100}, electronic_noise: }} # replaces the common physics: no scatter here
```

`physics: {from: bench}` takes the effects [that a diagnosis found](../how-to/diagnosis.md).

Each section gives the key of the effect, its stage and its parameters. A parameter has a **typical value** (its
default), a plausible range, a value at which the effect is off, and the range of a fit to one scan.

* **Order of stages**: STAGES. The effects on images act after the reconstruction. `snakemake diagnosis` fits the others
  to projections.
* **Geometry.** Rays run to the pixels of the rotated, flat or curved detector. Bowtie, heel and off-focal radiation use
  the nominal geometry. At 10 degrees off the central ray, 1 degree of tilt or skew changes their angles by 0.3 %.
* **Scatter** has one kernel, which does not depend on depth.
* **Baseline.** A study without effects uses one path length in one material instead of this chain. Both agree to 2e-5.
* **Materials.** A voxel is a mixture of two materials by its HU (`materials`). It is exact at the energy where water
  attenuates `mu_water_per_mm`. Attenuation is from xraylib, spectra are from SpekPy.
* **Sensor** (`sensor`, or `nominal.sensor` of a recording). Photons and their noise are weighted by the energy
  deposited in the sensor layer, with K escape and Compton scattering, or counted. 1/A are the noise-equivalent quanta
  of a pixel.
* **Units** apply to scans at another speed, dose or collimation. The exception is the amount of scatter, which
  decreases with the height of the beam. A dark signal is in photons per pixel in a study. For line integrals and
  images, it is a fraction of the mean signal in air.
* **Time.** View i of N is exposed in the middle of its interval dt, at t_i = (i + 1/2 - N/2) dt. dt is
  `scan.rotation_time_ms` divided by the number of views per rotation.
"""
WORDS = {
    PER_VIEW: "times the time from view to view",
    PER_SCAN: "over the scan",
    PER_SCAN_SQUARED: "over the square of the scan's duration",
    OF_AIR: "times the reading in air",
    OF_AIR_PER_SCAN: "times the reading in air over the scan",
    PER_AIR_PHOTON: "over the photons of a pixel in air",
    PER_PIXEL: "times the pitch of the pixels",
}


def heading(name: str) -> str:
    """Return the name of an effect as a heading: HU calibration for hu_calibration."""
    words = label(name)
    return words[:1].upper() + words[1:]


def section(name: str) -> str:
    """Return the section of an effect."""
    effect = load(name)
    lines = [f"## {heading(name)}", "", f"`{name}`, {label(effect.stage)}. {effect.physics}", ""]
    lines += [f"* {parameter_line(parameter)}" for parameter in effect.parameters]
    lines += [f"* **Equation**: {effect.equation}", f"* **Source**: {effect.source}"]
    lines += [f"* **Distinguished by**: {effect.signature}", f"* **Confirmed by**: {effect.settled_by}"]
    return "\n".join(lines)


def parameter_line(parameter: Parameter) -> str:
    """Return name, meaning, typical value and ranges of a parameter."""
    unit = "" if parameter.unit in ("1", "number") else f" {parameter.unit}"
    off = "" if parameter.neutral is None else f"; off at {parameter.neutral:g}"
    plausible = _range(parameter.low, parameter.high)
    line = f"`{parameter.name}`: {parameter.meaning}, **{parameter.typical:g}{unit}** ({plausible}{off})"
    if parameter.reach is not None:
        reach = _range(parameter.reach.low, parameter.reach.high)
        if parameter.reach.of == PER_SCAN and (change := parameter.unit.removesuffix("/s")) != "1":
            reach += f" {change}"  # a rate in mm/s is a change in mm
        line += f"; in a fit {reach} {WORDS[parameter.reach.of]}"
    return line


def _range(low: float, high: float) -> str:
    if math.isinf(high):
        return "any" if math.isinf(low) else f"{low:g} or more"
    return f"{low:g} to {high:g}"


def page() -> str:
    """Return the page: a section for every effect, in the order of stages."""
    order = sorted(names(), key=lambda name: STAGES.index(load(name).stage))
    stages = ", ".join(map(label, STAGES))
    return "\n\n".join([INTRODUCTION.replace("STAGES", stages).rstrip(), *map(section, order)]) + "\n"
