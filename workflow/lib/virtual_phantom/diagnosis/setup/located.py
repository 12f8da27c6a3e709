"""Registration of a known object with recorded images: its location and rotation in the plane."""

from __future__ import annotations

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.units import HU_AIR
from ...physics.scenes.objects import ShapedObject
from ...physics.scenes.scene import Pose
from ...physics.scenes.shapes import cylinder
from ...recordings.images import ImagesRecording
from ...recordings.in_plane import find
from ...recordings.registration import LEAST_CORRELATION
from ..comparison.regions import ScannedVolume, sampled
from ..images.scan import imaged_object, with_scan
from ..request import DiagnosisRequest
from .finding import AS_STATED, SetupResult

CLEARLY_BETTER = 0.05  # correlation inside an object that was mounted the other way round, over that as stated
# Variance of the difference of two scans as their files place them, over that after registration, from which the object
# has moved. Other kernels gave up to 1.96, as linear interpolation blurs; displacements by 0.3 voxels 3.3 or more.
MOVED = 2.5
LEAST_CONTRAST_HU, LEAST_INSIDE = 20.0, 0.6  # contrast that can be seen inside an object, and correlation there


def drawn_object(request: DiagnosisRequest, recording: ImagesRecording) -> ScannedVolume:
    """Return the object of a request as voxels in HU, discs included."""
    found = ScannedVolume.of(request, recording)
    if found is not None:
        return found
    disc = request.settings.disc
    shape = cylinder(disc.material, (0, 0, 0), disc.diameter_mm / 2)
    shaped = ShapedObject("disc", "A disc", (shape,), ("disc",), ())
    return ScannedVolume.of_shapes(shaped, request.protocol.geometry, request.mu_water_per_mm)


def locate(recording: ImagesRecording, request: DiagnosisRequest) -> SetupResult:
    """Register the object with the mean of all slices and repeats; maps are slices of images minus object, HU.

    Raises
    ------
    InputError
        If the object does not fit.
    """
    request = with_scan(request, recording)
    imaged, drawn, stated = imaged_object(request, recording.grid), drawn_object(request, recording).fine, {}
    taken = np.mean([repeat.array[imaged.slices] for repeat in recording.repeats], axis=0, dtype=np.float64)
    image, spacing = taken.mean(axis=0), recording.grid.spacing
    if not imaged.prism and "z_mm" in request.settings.location:
        stated = {"z_mm": request.settings.location["z_mm"]}

    def expected(shape: tuple[int, ...], spacing_mm: tuple[float, ...]) -> np.ndarray:
        on = Grid((1 if imaged.prism else len(taken), *shape), (spacing[0], *spacing_mm))
        return sampled(drawn.array, drawn.grid, on, Pose(**stated), order=1, outside=HU_AIR).mean(axis=0)

    known = expected(drawn.grid.shape[1:], drawn.grid.spacing[1:]), drawn.grid.spacing
    found = find(image, spacing, *known)
    # An object that is constant along z may be seen from its other end.
    either = imaged.prism and not request.settings.of_scan
    other = find(image[:, ::-1], spacing, *known) if either else found
    mirrored = other.inside > found.inside + CLEARLY_BETTER
    if mirrored:
        found, image = other, image[:, ::-1]
    least = LEAST_INSIDE if found.contrast > LEAST_CONTRAST_HU else -1.0
    if found.correlation < LEAST_CORRELATION or found.inside < least:
        raise InputError(
            f"recording {recording.name}: the object does not fit the images: correlation {found.correlation:.2f} (at "
            f"least {LEAST_CORRELATION:g}), inside {found.inside:.2f} (at least {least:g}); check object, slices "
            "(diagnosis.recordings: slices) and orientation"
        )
    rest = image - expected(image.shape, spacing[1:]), image - found.fitted
    share = [float(np.var(part) / np.var(image)) for part in rest]
    moved = not request.settings.of_scan or share[0] > MOVED * share[1]
    # Scans that lie on each other contradict a stated displacement.
    place = found.location if moved else {key: 0.0 for key in found.location if key in request.settings.location}
    return SetupResult("HU of the object", AS_STATED, {}, (), *share, rest, place | stated, mirrored)
