"""How long the diagnosis of one recording of projections takes, from what is known before it starts.

Work is counted in units that costs.rates has a rate for:

    job               one diagnosis: its start, its page
    compiled          kernels that are compiled, where no earlier run has done so
    plane             what a ray meets in the scanned object, if the description of the scan is checked: voxels along
                      the longer side in-plane x materials, or shapes; nothing of a disc
    point             pixels that are fitted, over all views, and a share of their rays (RAYS_PER_PIXEL): alignment,
                      verdict, images
    filter_point      matched filters: points x effects x rounds of the ranking
    filter_step       their steps through the object: rays x effects x planes x rounds
    evaluation        scans that fits simulate
    evaluation_point  the same x points

How many scans are simulated depends on what is found, by far more than on anything that is known beforehand. A forecast
is therefore a range, from a recording that lacks nothing to one that lacks several effects.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import yaml

from ...base.errors import refusing
from ...diagnosis.workload import fitted, is_shapes, rays_of
from ...physics.scenes.object_files import path_of
from ...physics.scenes.sampling import LEAST

STAGE = "diagnose"
UNITS = ("job", "compiled", "plane", "point", "filter_point", "filter_step", "evaluation", "evaluation_point")
# Units of which several processes share the work.
SHARED = ("filter_point", "filter_step", "evaluation", "evaluation_point")
# What a pixel costs beside its rays, in rays: fits of one scan with 1, 4 and 9 rays per pixel took 5.8, 10.7 and 14.8 s
# (benchmarks/diagnosis_rates.py --busy, "scatter"), filters 2.0, 3.3 and 4.8 s.
RAYS_PER_PIXEL = 5
# Scans that a diagnosis simulates, and rounds of ranking effects: 365 to 1,177 and 1 to 3 where nothing or one
# effect was found (ten simulated recordings), 7,437 and 11 (of few effects each) with three on a real disc.
EVALUATIONS = (400, 4200)
ROUNDS = (1, 4)
# Rates are off, too: ten of eleven diagnoses took what is forecast with this factor either way, and the other one 0.8
# times the lower end (rates.yaml, tests/study/test_forecasts.py).
RATES_OFF = 1.25


@dataclass(frozen=True)
class Forecast:
    """How long a diagnosis takes, s.

    Attributes
    ----------
    cpu : tuple of 2 float
        Lower and upper end of the CPU time of all its processes.
    wall : tuple of 2 float
        The same of the wall time, on otherwise idle cores.
    """

    cpu: tuple[float, float]
    wall: tuple[float, float]


@dataclass(frozen=True)
class Extent:
    """How large a diagnosis is.

    Attributes
    ----------
    pixels, rays : int
        That are fitted, over all views; rays of a pixel are counted one by one, and of a source that is declared to be
        wide those of every point.
    planes : int
        As the unit `plane`.
    effects : int
        That are tried.
    checked : bool
        Whether the description of the scan is.
    """

    pixels: int
    rays: int
    planes: int
    effects: int
    checked: bool

    def work(self, evaluations: int, rounds: int, compiled: bool = False) -> dict[str, float]:
        """{unit: amount}.

        Parameters
        ----------
        evaluations : int
            Scans that fits simulate.
        rounds : int
            In which effects are ranked.
        compiled : bool, optional
            Whether kernels are compiled.
        """
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
        """How long the diagnosis takes.

        Parameters
        ----------
        rates : mapping
            As rates.read_rates gives them.
        processes : int, optional
            Side by side. They share fits and filters: at best evenly, at worst with half of them idle.

        Returns
        -------
        Forecast or None
            None without rates.
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


def extent(settings: Mapping, shape: tuple[int, int, int], effects: int, phantom: tuple[Sequence[int], int]) -> Extent:
    """Of a recording of projections.

    Parameters
    ----------
    settings : mapping
        Its section of the configuration: samples, view_step, check_setup, disc, object, baseline.
    shape : tuple of 3 int
        Of the scan: views, rows, columns.
    effects : int
        That are tried.
    phantom : tuple of (sequence of 3 int, int)
        Voxels of the study's phantom along z, y and x, and how many materials it is divided into; for a recording of
        it.

    Raises
    ------
    InputError
        If what was scanned is a file that cannot be read.
    """
    views, rows, columns = shape
    samples, step = fitted(settings.get("samples"), settings.get("view_step"), is_shapes(settings), shape)
    seen = math.ceil(views / step), rows, columns
    rays = rays_of(seen, samples) * source_points(settings.get("baseline", {}))
    return Extent(math.prod(seen), rays, _planes(settings, phantom), effects, settings["check_setup"])


def source_points(declared: Collection[str]) -> int:
    """From how many points rays come in every model, at least.

    Parameters
    ----------
    declared : collection of str
        Effects that are known of the scanner.
    """
    spot = LEAST**2 if "focal_spot" in declared else 1
    beside = LEAST if "off_focal_radiation" in declared else 0
    return (spot + beside) * (LEAST if "view_blur" in declared else 1)


def materials_of(section: Mapping) -> int:
    """How many materials the study's phantom is divided into.

    Parameters
    ----------
    section : mapping
        Of the configuration: materials.
    """
    return 1 if section["dense"] is None else 2


def _planes(settings: Mapping, phantom: tuple[Sequence[int], int]) -> int:
    if "disc" in settings:
        return 0
    of = settings.get("object", {})
    if "kind" in of:
        return _shapes(of["kind"])
    voxels, materials = phantom
    if of:
        from ...io.volumes import shape_of  # half a second, for those who need it

        voxels, materials = shape_of(of.get("mask") or of["labels"]), len(of["materials"]) if "labels" in of else 1
    return max(voxels[1:]) * materials


def _shapes(kind: str) -> int:
    """How many an object has."""
    path = path_of(kind)
    with refusing(
        f"{path}: holds no shapes", OSError, yaml.YAMLError, KeyError, TypeError, advice="see docs/how-to/objects.md"
    ):
        return len(yaml.safe_load(path.read_text(encoding="utf-8"))["shapes"])


def rays_in_words(count: int) -> str:
    """A number of rays to two digits."""
    return f"{count / 1e6:.2g} million rays" if count >= 1e5 else f"{count / 1e3:.2g} thousand rays"
