"""Registration of a known object with recorded images: its location and rotation in the plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from skimage.measure import block_reduce

from ...base.geometry import Grid
from ...base.units import HU_AIR
from ...io.volumes import Volume
from ...physics.scenes.objects import ShapedObject
from ...physics.scenes.scene import Pose
from ...physics.scenes.shapes import cylinder
from ...recordings.images import ImagesRecording
from ...recordings.registration import Search
from ..comparison.regions import ScannedVolume, sampled
from ..images.scan import ImagedObject, imaged_object, with_scan
from ..request import DiagnosisRequest
from .finding import AS_STATED, SetupResult

LEAST_VOXEL_MM = 1.0  # of the images that are registered
CLEARLY_BETTER = 0.05  # correlation inside an object that was mounted the other way round, over that as stated
PRISM_SLICES = 4  # copies of a slice, as the registration works on volumes


@dataclass(frozen=True)
class ObjectLocated(SetupResult):
    """Location of the object in the images.

    Attributes
    ----------
    mirrored : bool
        Whether an object that is constant along z is seen from its other end.
    stated, best : ndarray, shape (y, x)
        Slices of images minus object, HU.
    """

    location: Mapping[str, float] = field(default_factory=dict)
    mirrored: bool = False
    stated: np.ndarray = field(default=None, repr=False)
    best: np.ndarray = field(default=None, repr=False)
    of: ClassVar[str] = "HU of the object"

    @property
    def content(self) -> dict:
        """See SetupResult.content."""
        return super().content | {"mirrored": self.mirrored}

    def maps(self) -> tuple[np.ndarray, np.ndarray]:
        """See SetupResult.maps."""
        return self.stated, self.best


def drawn_object(request: DiagnosisRequest, recording: ImagesRecording) -> ScannedVolume:
    """Return the object of a request as voxels in HU, discs included."""
    found = ScannedVolume.of(request, recording)
    if found is not None:
        return found
    disc = request.settings.disc
    shape = cylinder(disc.material, (0, 0, 0), disc.diameter_mm / 2)
    shaped = ShapedObject("disc", "A disc", (shape,), ("disc",), ())
    return ScannedVolume.of_shapes(shaped, request.protocol.geometry, request.mu_water_per_mm)


def locate(recording: ImagesRecording, request: DiagnosisRequest) -> ObjectLocated:
    """Register the object with the mean of the repeats.

    Raises
    ------
    InputError
        If the object does not fit.
    """
    request = with_scan(request, recording)
    imaged = imaged_object(request, recording.grid)
    mean = np.mean([repeat.array[imaged.slices] for repeat in recording.repeats], axis=0, dtype=np.float64)
    image = _image(mean, recording.grid, imaged)
    drawn, stated = drawn_object(request, recording), request.settings.location
    height = Pose(z_mm=stated.get("z_mm", 0.0))

    def expected(pose: Pose) -> np.ndarray:
        return sampled(drawn.fine.array, drawn.fine.grid, image.grid, pose, order=1, outside=HU_AIR)

    # An object that is constant along z may be seen from its other end.
    views = {False: image} | ({True: replace(image, array=image.array[..., ::-1].copy())} if imaged.prism else {})
    phantom = Volume(expected(height).astype(np.float32), image.grid)
    searches = {mirrored: Search(view, phantom, recording.name) for mirrored, view in views.items()}
    starts = {mirrored: search.coarse_in_plane() for mirrored, search in searches.items()}
    mirrored = bool(len(starts) > 1 and starts[True][0] > starts[False][0] + CLEARLY_BETTER)
    transform = searches[mirrored].refine_in_plane(starts[mirrored][1])
    searches[mirrored].checked_in_plane(transform)
    image = views[mirrored]
    x, y = transform.TransformPoint((0.0, 0.0, 0.0))[:2]
    turn = np.rad2deg(transform.GetAngleZ())
    location = {"x_mm": float(x), "y_mm": float(y), "turn_deg": float(turn)} | (
        {"z_mm": stated["z_mm"]} if "z_mm" in stated and not imaged.prism else {}
    )
    middle = image.array.shape[0] // 2
    rest = [image.array[middle] - expected(pose)[middle] for pose in (height, Pose(**location))]
    share = [float(np.var(part) / np.var(image.array[middle])) for part in rest]
    return ObjectLocated(AS_STATED, {}, (), share[0], share[1], location, mirrored, *rest)


def _image(mean: np.ndarray, grid: Grid, imaged: ImagedObject) -> Volume:
    """Return slices on voxels of about LEAST_VOXEL_MM, centered at the isocenter; of a prism, copies of one slice."""
    if imaged.prism:
        mean = np.repeat(mean.mean(axis=0, keepdims=True), PRISM_SLICES, axis=0)
    sides = mean.shape[1:]
    many = max(1, round(LEAST_VOXEL_MM / grid.spacing[1]))
    if any(side % many for side in sides):
        many = 1
    cut = block_reduce(mean, (1, many, many), np.mean)
    spacing = (grid.spacing[0], *(many * step for step in grid.spacing[1:]))
    return Volume(cut.astype(np.float32), Grid(cut.shape, spacing))
