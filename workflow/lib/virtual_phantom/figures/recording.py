"""Overview of a recording: sinogram and reconstructed slice, or slices of its images."""

import numpy as np
from matplotlib.figure import Figure

from ..base.errors import InputError
from ..base.geometry import Grid, OrbitGeometry
from ..io.volumes import Volume
from ..projectors import projector
from ..reconstruction.fbp import fbp
from . import style

MOST_PIXELS = 512  # pixels along a side of the slice
PERCENTILES = (0.5, 99.5)
SMALLEST_TRANSMISSION = 1e-5


@style.styled()
def draw_projections(
    line_integrals: np.ndarray, geometry: OrbitGeometry, title: str, unit: str = "mm", angles: bool = True
) -> Figure:
    """Draw the sinogram of the middle row, and the slice at the isocenter by filtered back-projection.

    If a scan cannot be reconstructed, the reason is shown instead of the slice.

    Parameters
    ----------
    line_integrals : ndarray, shape (views, rows, columns)
        Values that are not finite are replaced by 0.
    title : str
        Start of the sinogram's title.
    unit : str, optional
        Unit of lengths.
    angles : bool, optional
        Whether the view angles are known.
    """
    filled = np.where(np.isfinite(line_integrals), line_integrals, 0).astype(np.float32)
    figure = style.figure(style.DOUBLE_COLUMN_MM, 82)
    left, right = figure.subplots(1, 2)
    degrees = np.rad2deg(geometry.angles_rad)
    columns = geometry.column_positions_mm()
    extent = (columns[0], columns[-1], *((degrees[-1], degrees[0]) if angles else (geometry.views - 0.5, -0.5)))
    shown = left.imshow(filled[:, geometry.rows // 2], extent=extent, aspect="auto", cmap="gray")
    left.set(
        xlabel=f"detector column ({unit})",
        ylabel="view angle (degrees)" if angles else "view",
        title=f"{title}: sinogram, middle row",
    )
    figure.colorbar(shown, ax=left, label="line integral", location="bottom")
    try:
        image, half = _slice(filled, geometry, angles)
    except InputError as error:
        right.set_axis_off()
        right.text(0.5, 0.5, f"no slice:\n{error}", ha="center", va="center", wrap=True, transform=right.transAxes)
        return figure
    low, high = np.percentile(image, PERCENTILES)
    box = (-half, half, -half, half)
    shown = right.imshow(image, extent=box, origin="lower", cmap="gray", vmin=min(low, 0), vmax=high)
    right.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", title="slice at the isocenter, FBP")
    figure.colorbar(shown, ax=right, label=f"attenuation (1/{unit})", location="bottom")
    return figure


def _slice(line_integrals, geometry, angles):
    """Reconstruct the slice at z = 0 by FBP: [y, x] in 1/mm, and half of its side in mm."""
    if not angles:
        raise InputError("the view angles are not known")
    side = 2 * geometry.field_of_view_radius_mm
    pixel = max(geometry.column_pitch_mm / geometry.magnification, side / MOST_PIXELS)
    size = int(side / pixel)
    grid = Grid((1, size, size), (geometry.row_pitch_mm / geometry.magnification, pixel, pixel))
    return fbp(projector("cpu", geometry, grid), line_integrals[None])[0, 0], size * pixel / 2


@style.styled()
def draw_images(image: Volume, title: str) -> Figure:
    """Draw the middle axial and coronal slices of an image (HU); titles begin with `title`."""
    figure = style.figure(style.DOUBLE_COLUMN_MM, 92)
    axes = figure.subplots(1, 2)
    depth, height, width = image.grid.extent_mm
    nz, ny, _ = image.grid.shape
    views = (
        ("axial", image.array[nz // 2], (width, height), ("x", "y")),
        ("coronal", image.array[:, ny // 2], (width, depth), ("x", "z")),
    )
    for panel, (name, slice_hu, (across, up), (horizontal, vertical)) in zip(axes, views, strict=True):
        box = (-across / 2, across / 2, -up / 2, up / 2)
        shown = panel.imshow(slice_hu, extent=box, origin="lower", cmap="gray", vmin=-160, vmax=240)
        panel.invert_xaxis()  # radiological orientation: x increases to the patient's right, on the left
        panel.set(xlabel=f"{horizontal} from the center (mm)", ylabel=f"{vertical} from the center (mm)")
        panel.set_title(f"{title}: {name}")
    figure.colorbar(shown, ax=axes, label="CT number (HU)", location="bottom", shrink=0.5)
    return figure
