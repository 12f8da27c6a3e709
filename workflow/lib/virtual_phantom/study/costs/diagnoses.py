"""What the diagnosis of one recording of projections has to do, from what is known before it starts.

Work is counted in units that costs.rates has a rate for, those of one process and those that processes share out:

    job          one diagnosis: its start, its page
    plane        what a ray meets in the scanned object, if the description of the scan is checked: voxels along the
                 longer side in-plane x materials, or shapes; nothing of a disc
    ray          rays that are fitted, those of a pixel counted one by one: alignment, verdict, images
    filter_ray   matched filters of a process: rays x effects
    filter_step  their steps through the object: filter_ray x planes
    fit_ray      fits of a process: rays x fits, of as many effects as filters leave at most

How many fits follow depends on what is found. The rates are means of recordings that lack nothing or one effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import yaml

from ...base.errors import refusing
from ...diagnosis.extent import FEW, rays_of, step_for
from ...physics.object_files import path_of

STAGE = "diagnose"
UNITS = ("job", "plane", "ray", "filter_ray", "filter_step", "fit_ray")


@dataclass(frozen=True)
class Extent:
    """How large a diagnosis is.

    Attributes
    ----------
    rays : int
        That are fitted, those of a pixel counted one by one.
    planes : int
        As the unit `plane`.
    effects : int
        That are tried.
    checked : bool
        Whether the description of the scan is.
    """

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
        filters, fits = (math.ceil(count / processes) for count in (self.effects, min(self.effects, FEW)))
        return {
            "job": 1,
            "plane": self.planes if self.checked else 0,
            "ray": self.rays,
            "filter_ray": self.rays * filters,
            "filter_step": self.rays * filters * self.planes,
            "fit_ray": self.rays * fits,
        }


def extent(settings: Mapping, shape: tuple[int, int, int], effects: int, phantom: tuple[Sequence[int], int]) -> Extent:
    """Of a recording of projections.

    Parameters
    ----------
    settings : mapping
        Its section of the configuration: samples, view_step, check_setup, disc, object.
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
    step = settings.get("view_step") or step_for(shape, settings["samples"])
    rays = rays_of((math.ceil(views / step), rows, columns), settings["samples"])
    return Extent(rays, _planes(settings, phantom), effects, settings["check_setup"])


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
