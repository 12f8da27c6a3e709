"""Forecast of the time of the diagnosis of one recording of projections.

Work is counted in units, each with a rate in costs.rates::

    job               one diagnosis: start and page
    compiled          compilation of kernels, if no earlier run has done so
    plane             planes of the scanned object that a ray crosses, if the scan set-up is checked: voxels along the
                      longer side in-plane x materials, or number of shapes; 0 for a disc
    point             fitted pixels of all views plus a fraction of their rays (RAYS_PER_PIXEL): alignment, verdict,
                      images
    filter_point      matched filters: points x effects x rounds of the ranking
    filter_step       steps of the matched filters through the object: rays x effects x planes x rounds
    evaluation        simulated scans of the fits
    evaluation_point  evaluations x points

The number of simulated scans depends mostly on what the diagnosis finds. A forecast is therefore a range, from a
recording without missing effects to a recording with several.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import yaml

from ...base.errors import refusing
from ...base.settings import MaterialSettings
from ...diagnosis.settings import LabelledObject, RecordingSettings, ShapesObject
from ...diagnosis.workload import rays_of, samples_and_step
from ...physics.scenes.object_files import object_path
from ...physics.scenes.sampling import MIN_POINTS

STAGE = "diagnose"
UNITS = ("job", "compiled", "plane", "point", "filter_point", "filter_step", "evaluation", "evaluation_point")
# Units that several processes share.
SHARED = ("filter_point", "filter_step", "evaluation", "evaluation_point")
# Cost of a pixel in addition to its rays, in rays. Fits of one scan with 1, 4 and 9 rays per pixel took 5.8, 10.7 and
# 14.8 s, filters 2.0, 3.3 and 4.8 s (the recording "scatter" of benchmarks/diagnosis_rates.py).
RAYS_PER_PIXEL = 5
# Simulated scans and rounds of ranking. Ten simulated recordings in which no or one effect was found needed 365 to
# 1,177 scans and 1 to 3 rounds. A real disc with three effects needed 7,437 scans and 11 rounds of few effects.
EVALUATIONS = (400, 4200)
ROUNDS = (1, 4)
# Uncertainty of the rates. With this factor, ten of eleven diagnoses were inside the forecast; the other one took 0.8
# times the lower end (rates.yaml, tests/study/test_forecasts.py).
RATES_OFF = 1.25


@dataclass(frozen=True)
class Forecast:
    """Lower and upper end of the CPU time of all processes and of the wall time on otherwise idle cores, s."""

    cpu: tuple[float, float]
    wall: tuple[float, float]


@dataclass(frozen=True)
class Extent:
    """Size of a diagnosis.

    Attributes
    ----------
    pixels, rays : int
        Fitted pixels and rays of all views. A pixel may have several rays, and a wide source several points per ray.
    planes : int
        See the unit `plane`.
    effects : int
        Candidate effects.
    checked : bool
        Whether the scan set-up is checked.
    """

    pixels: int
    rays: int
    planes: int
    effects: int
    checked: bool

    def work(self, evaluations: int, rounds: int, compiled: bool = False) -> dict[str, float]:
        """Return {unit: amount} for numbers of simulated scans and of ranking rounds, with or without compilation."""
        points, filters = self.pixels + self.rays / RAYS_PER_PIXEL, self.effects * rounds
        return {
            "job": 1,
            "compiled": int(compiled),
            "plane": self.planes if self.checked else 0,
            "point": points,
            "filter_point": points * filters,
            "filter_step": self.rays * filters * self.planes,
            "evaluation": evaluations,
            "evaluation_point": points * evaluations,
        }

    def forecast(self, rates: Mapping, processes: int = 1) -> Forecast | None:
        """Return the forecast of the diagnosis; None if `rates` (see rates.read_rates) has no rates for it.

        Parallel processes share fits and filters: in the best case evenly, in the worst case with half of them idle.
        """
        units = rates["seconds"].get(STAGE)
        if units is None:
            return None
        cpu, wall = [], []
        for end, off, at_work in ((0, 1 / RATES_OFF, processes), (1, RATES_OFF, (1 + processes) / 2)):
            work = self.work(EVALUATIONS[end], ROUNDS[end], compiled=bool(end))
            costs = {unit: off * rate * work[unit] for unit, rate in units.items()}
            shared = sum(costs.get(unit, 0.0) for unit in SHARED)
            cpu.append(sum(costs.values()))
            wall.append(cpu[-1] - shared + shared / at_work)
        return Forecast((cpu[0], cpu[1]), (wall[0], wall[1]))


def extent(
    settings: RecordingSettings, shape: tuple[int, int, int], effects: int, phantom: tuple[Sequence[int], int]
) -> Extent:
    """Return the size of the diagnosis of a recording of projections.

    Parameters
    ----------
    shape : tuple of 3 int
        Views, rows and columns of the scan.
    effects : int
        Number of candidate effects.
    phantom : tuple of (sequence of 3 int, int)
        Voxels along z, y and x and number of materials of the study's phantom, for a recording of it.

    Raises
    ------
    InputError
        If the file of the scanned object cannot be read.
    """
    views, rows, columns = shape
    samples, step = samples_and_step(settings.samples, settings.view_step, shape)
    fitted_shape = math.ceil(views / step), rows, columns
    rays = rays_of(fitted_shape, samples) * points_of_source(settings.baseline)
    return Extent(math.prod(fitted_shape), rays, _planes(settings, phantom), effects, settings.check_setup)


def points_of_source(declared: Collection[str]) -> int:
    """Return the minimum number of source points in every model, given the declared effects of the scanner."""
    focal = MIN_POINTS**2 if "focal_spot" in declared else 1
    off_focal = MIN_POINTS if "off_focal_radiation" in declared else 0
    return (focal + off_focal) * (MIN_POINTS if "view_blur" in declared else 1)


def material_count(materials: MaterialSettings) -> int:
    """Return the number of materials of the study's phantom."""
    return 1 if materials.dense is None else 2


def _planes(settings: RecordingSettings, phantom: tuple[Sequence[int], int]) -> int:
    if settings.disc is not None or settings.simulation is not None or settings.of_scan:
        return 0
    scanned = settings.object
    if isinstance(scanned, ShapesObject):
        return _shape_count(scanned.kind)
    voxels, materials = phantom
    if scanned is not None:
        from ...io.volumes import shape_of  # slow import

        of_labels = isinstance(scanned, LabelledObject)
        voxels = shape_of(scanned.labels if of_labels else scanned.mask)
        materials = len(scanned.materials) if of_labels else 1
    return max(voxels[1:]) * materials


def _shape_count(kind: str) -> int:
    path = object_path(kind)
    with refusing(
        f"{path}: has no shapes", OSError, yaml.YAMLError, KeyError, TypeError, advice="see docs/how-to/objects.md"
    ):
        return len(yaml.safe_load(path.read_text(encoding="utf-8"))["shapes"])


def rays_text(count: int) -> str:
    """Return a number of rays in words, with two digits."""
    return f"{count / 1e6:.2g} million rays" if count >= 1e5 else f"{count / 1e3:.2g} thousand rays"
