"""Figures of the image quality of a phantom: location, resolution, HU, noise and uniformity of a module."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from ..base.names import label
from ..image_quality.location import Location
from . import style

WINDOW_HU = (-150.0, 250.0)
POLAR_PERCENTILE = 99.0
NUMBERED = 0.8  # position of the number of an insert, relative to its distance from the center


@style.styled()
def draw_module(
    image: np.ndarray,
    extent_mm: Sequence[float],
    found: Location | None,
    inserts: Sequence[str],
    noise: pd.DataFrame | None,
    tile_mm: float | None,
) -> Figure:
    """Draw the mean slice of a module with outline and numbered inserts, and the noise of each tile of the spectrum."""
    figure = style.figure(style.DOUBLE_COLUMN_MM, 78)
    panels = figure.subplots(1, 2)
    height, width = extent_mm
    box = (-width / 2, width / 2, -height / 2, height / 2)
    for axes in panels:
        axes.imshow(image, extent=box, origin="lower", cmap="gray", vmin=WINDOW_HU[0], vmax=WINDOW_HU[1])
        axes.invert_xaxis()  # radiological orientation, as in figures.recording
        axes.set(xlabel="x from the center (mm)", ylabel="y from the center (mm)")
    style.letter_panel(panels[0], 0, "mean slice" if found is None else "mean slice with the object as found")
    style.letter_panel(panels[1], 1, "noise by location")
    if found is not None:
        x, y = found.centers.mean(axis=0)
        for radius, dx, dy in ((found.radius, 0, 0), *((one.radius, one.x, one.y) for one in found.inserts)):
            panels[0].add_patch(Circle((x + dx, y + dy), radius, fill=False, color=style.ORANGE, linewidth=0.8))
        for one in found.inserts:
            if one.name in inserts:
                place = x + one.x * NUMBERED, y + one.y * NUMBERED
                text = str(list(inserts).index(one.name) + 1)
                panels[0].annotate(text, place, color=style.YELLOW, ha="center", va="center", weight="bold")
    if noise is not None:
        corners = zip(noise["x_mm"] - tile_mm / 2, noise["y_mm"] - tile_mm / 2, strict=True)
        tiles = PatchCollection([Rectangle(corner, tile_mm, tile_mm) for corner in corners], cmap="viridis")
        tiles.set_array(noise["sd_hu"].to_numpy())
        figure.colorbar(panels[1].add_collection(tiles), ax=panels[1], label="SD of noise (HU)", shrink=0.7)
    return figure


@style.styled(grid=True)
def draw_inserts(inserts: pd.DataFrame, ttf: pd.DataFrame, regression: dict | None) -> Figure:
    """Draw the TTF of every insert, its 50 % frequency against contrast, and HU against composition."""
    figure = style.figure(style.DOUBLE_COLUMN_MM, 70)
    curves, contrast, hu = figure.subplots(1, 3)
    looks = style.assign(inserts["insert"], style.ON_WHITE), style.assign(inserts["insert"], style.MARKERS)
    for row in inserts.itertuples():
        color, marker = (look[row.insert] for look in looks)
        one = ttf[ttf["insert"] == row.insert]
        text = f"{list(inserts['insert']).index(row.insert) + 1} {label(row.insert)} ({row.contrast_hu:+.0f} HU)"
        text = text.replace("-", "−")
        values = one["ttf"].to_numpy()
        rises = np.flatnonzero((np.diff(values) > 0) & (values[1:] < 0.5))
        shown = slice(0, rises[0] + 1 if len(rises) else None)  # then noise
        curves.plot(one["frequency_per_mm"].to_numpy()[shown], values[shown], color=color, label=text)
        spread = {"yerr": row.f50_error} if np.isfinite(row.f50_error) else {}
        contrast.errorbar(abs(row.contrast_hu), row.f50_per_mm, **spread, color=color, marker=marker, markersize=4)
        if regression and row.insert in regression["nominal_hu"]:
            nominal = regression["nominal_hu"][row.insert]
            line = regression["intercept_hu"] + regression["slope"] * nominal
            hu.plot(nominal, row.hu - line, color=color, marker=marker, markersize=4)
    curves.set(xlabel="frequency (1/mm)", ylabel="TTF", ylim=(0, 1.1))
    contrast.set(xlabel="|contrast| (HU)", ylabel="frequency at TTF 0.5 (1/mm)", xscale="log")
    contrast.xaxis.set_major_formatter(style.number_formatter())
    for index, (axes, title) in enumerate(((curves, "resolution"), (contrast, "by contrast"), (hu, "HU accuracy"))):
        style.letter_panel(axes, index, title)
    if regression:
        hu.axhline(0, color=style.GREY, linewidth=0.8)
        hu.set(xlabel=f"nominal HU at {regression['energy_kev']:g} keV", ylabel="measured − line (HU)")
    else:
        hu.set_axis_off()
    figure.legend(*curves.get_legend_handles_labels(), loc="outside lower center", ncol=4)
    return figure


@style.styled(grid=True)
def draw_noise(spectra: pd.DataFrame) -> Figure:
    """Draw the noise power spectra in the plane and along z."""
    figure = style.figure(style.DOUBLE_COLUMN_MM, 62)
    plane, along = figure.subplots(1, 2)
    colors = {"in plane": style.BLUE, "between slices": style.ORANGE}
    for kind, color in colors.items():
        one = spectra[(spectra["kind"] == kind) & (spectra["frequency_per_mm"] > 0)]
        if len(one):
            plane.plot(one["frequency_per_mm"], one["power"], color=color, label=kind)
    plane.set(xlabel="frequency in the plane (1/mm)", ylabel="noise power (HU² mm²)", ylim=(0, None))
    plane.legend()
    style.letter_panel(plane, 0, "axial plane")
    one = spectra[spectra["kind"] == "along z"]
    style.letter_panel(along, 1, "along z")
    if len(one):
        along.plot(one["frequency_per_mm"], one["power"], color=style.BLUE, marker="o", markersize=3)
        along.set(xlabel="frequency along z (1/mm)", ylabel="noise power (HU² mm)", ylim=(0, None))
    else:
        along.set_axis_off()
        along.text(0.5, 0.5, "too few slices", ha="center", transform=along.transAxes)
    return figure


@style.styled()
def draw_uniformity(radial: pd.DataFrame, angular: pd.DataFrame) -> Figure:
    """Draw the radial profile with its cupping, and maps of the rest over radius and angle, as measured and fitted."""
    figure = style.figure(style.DOUBLE_COLUMN_MM, 66)
    profile, measured, fitted = figure.subplots(1, 3)
    inside = radial[radial["cupping_hu"].notna()]
    profile.plot(inside["r_mm"], inside["hu"], color=style.BLUE, label="measured")
    profile.plot(inside["r_mm"], inside["cupping_hu"], color=style.VERMILLION, label="cupping (fit)")
    profile.set(xlabel="radius (mm)", ylabel="mean HU")
    profile.legend()
    style.letter_panel(profile, 0, "radial profile")
    most = float(np.percentile(np.abs(angular["hu"]), POLAR_PERCENTILE))
    shown = _polar(measured, angular, "hu", most)
    style.letter_panel(measured, 1, "angular variation")
    if "half_turn_hu" in angular and angular["half_turn_hu"].notna().all():
        _polar(fitted, angular, "half_turn_hu", most)
        style.letter_panel(fitted, 2, "fit: column error, half turn")
    else:
        fitted.set_axis_off()
    figure.colorbar(shown, ax=[measured, fitted], label="HU", location="bottom", shrink=0.6)
    return figure


def _polar(axes: Axes, angular: pd.DataFrame, column: str, most: float):
    table = angular.pivot(index="r_mm", columns="angle_deg", values=column)
    box = (0, 360, table.index[-1], table.index[0])
    shown = axes.imshow(table.to_numpy(), extent=box, aspect="auto", cmap="gray", vmin=-most, vmax=most)
    axes.set(xlabel="angle from +x to +y (degrees)", ylabel="radius (mm)", xticks=[0, 90, 180, 270, 360])
    return shown


@style.styled(grid=True)
def draw_slice_profile(profile: pd.DataFrame, fwhm_mm: float) -> Figure:
    """Draw the slice sensitivity profile."""
    figure = style.figure(style.SINGLE_COLUMN_MM, 60)
    axes = figure.subplots()
    axes.plot(profile["z_mm"], profile["profile"], color=style.BLUE)
    axes.set(xlabel="z (mm)", ylabel="relative sensitivity", xlim=(-3 * fwhm_mm, 3 * fwhm_mm))
    axes.set_title(f"slice profile: FWHM {style.number(fwhm_mm)} mm")
    return figure


@style.styled(grid=True)
def draw_dose(series: dict) -> Figure:
    """Draw noise against dose on logarithmic axes, beside the law of quantum noise."""
    figure = style.figure(style.SINGLE_COLUMN_MM, 60)
    axes = figure.subplots()
    doses, sd = np.array(series["doses"]), np.array(series["sd_hu"])
    axes.plot(doses, sd, color=style.BLUE, marker="o", markersize=4, label="measured")
    axes.plot(doses, sd[-1] * np.sqrt(doses[-1] / doses), color=style.GREY, linestyle="--", label="1 / √dose")
    axes.set(xscale="log", yscale="log", xlabel=label(series["quantity"]), ylabel="SD of noise (HU)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(style.number_formatter())
        axis.set_minor_formatter(style.number_formatter())
    axes.legend()
    return figure
