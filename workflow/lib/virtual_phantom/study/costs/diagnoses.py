"""What the diagnosis of one recording of projections has to do, from what is known before it starts.

Work is counted in units that costs.rates has a rate for, those of one process and those that processes share out:

    job           one diagnosis: its start, its page
    plane         what a ray meets in the scanned object, if the description of the scan is checked: voxels along the
                  longer side in-plane x materials, or shapes; nothing of a disc
    point         pixels that are fitted, over all views, and a share of their rays (RAYS_PER_PIXEL): alignment,
                  verdict, images
    filter_point  matched filters of a process: points x effects
    filter_step   their steps through the object: rays x effects x planes
    fit_point     fits of a process: points x fits (EFFECTS_PER_FIT)

How many fits follow depends on what is found. The rates are means of recordings that lack nothing or one effect.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import yaml

from ...base.errors import refusing
from ...diagnosis.extent import fitted, is_shapes, rays_of
from ...physics.object_files import path_of
from ...physics.sampling import LEAST

STAGE = "diagnose"
UNITS = ("job", "plane", "point", "filter_point", "filter_step", "fit_point")
# What a pixel costs beside its rays, in rays: fits of one scan with 1, 4 and 9 rays per pixel took 5.8, 10.7 and 14.8 s
# (benchmarks/diagnosis_rates.py --busy, "scatter"), filters 2.0, 3.3 and 4.8 s.
RAYS_PER_PIXEL = 5
# Of so many effects one is fitted: 4 to 8 of 27 were in eleven recordings that lacked nothing or one effect.
EFFECTS_PER_FIT = 4


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

    def work(self, processes: int = 1) -> dict[str, float]:
        """{unit: amount}.

        Parameters
        ----------
        processes : int, optional
            Side by side.

        Returns
        -------
        dict of str to float
        """
        points, fits = self.pixels + self.rays / RAYS_PER_PIXEL, math.ceil(self.effects / EFFECTS_PER_FIT)
        filters = math.ceil(self.effects / processes)
        return {
            "job": 1,
            "plane": self.planes if self.checked else 0,
            "point": points,
            "filter_point": points * filters,
            "filter_step": self.rays * filters * self.planes,
            "fit_point": points * math.ceil(fits / processes),
        }


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

    Returns
    -------
    Extent

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

    Returns
    -------
    int
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

    Returns
    -------
    int
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
        f"{path}: holds no shapes", OSError, yaml.YAMLError, KeyError, TypeError, advice="see docs/objects.md"
    ):
        return len(yaml.safe_load(path.read_text(encoding="utf-8"))["shapes"])


def rays_in_words(count: int) -> str:
    """A number of rays to two digits."""
    return f"{count / 1e6:.2g} million rays" if count >= 1e5 else f"{count / 1e3:.2g} thousand rays"
