"""Report of image quality: files of `snakemake image_quality`, and one HTML page."""

from __future__ import annotations

import math
from pathlib import Path

from matplotlib.figure import Figure

from ..figures import image_quality as figures
from ..figures import style
from ..image_quality.measure import ImageQuality
from ..io.documents import IMAGE_QUALITY, write_document
from ..io.files import write_csv, write_text
from .html import number, picture, render


def write_image_quality(found: ImageQuality, *, document: str, page: str, tables: str, pictures: str) -> None:
    """Write image_quality.json, the page, and the folders of tables and figures."""
    drawn = _figures(found)
    for folder in (tables, pictures):
        Path(folder).mkdir(parents=True, exist_ok=True)
    for name, table in found.tables.items():
        write_csv(table, Path(tables) / f"{name}.csv")
    for name, figure in drawn.items():
        style.save(figure, [Path(pictures) / f"{name}.png"])
    shown = {name: picture(figure) for name, figure in drawn.items()}
    filters = {"number": number, "with_error": with_error}
    write_text(render("image_quality", filters, d=found.content, pictures=shown), page)
    write_document(found.content, document, IMAGE_QUALITY)


def _figures(found: ImageQuality) -> dict[str, Figure]:
    drawn = {}
    for recording, entry in found.content["recordings"].items():
        for module, content in entry["modules"].items():
            rows = {
                name: table[(table["recording"] == recording) & (table["module"] == module)]
                for name, table in found.tables.items()
            }
            rows = {name: table for name, table in rows.items() if len(table)}
            image, grid, location = found.images[f"{recording}, {module}"]
            key = f"{recording}_{module}"
            numbered = [one["insert"] for one in content["inserts"]]
            tile_mm = content["noise"] and content["noise"]["tile_mm"]
            drawn[f"{key}_module"] = figures.draw_module(
                image, grid.extent_mm[1:], location, numbered, rows.get("noise_by_location"), tile_mm
            )
            if "inserts" in rows:
                drawn[f"{key}_inserts"] = figures.draw_inserts(rows["inserts"], rows["ttf"], content["hu"])
            if "noise_spectra" in rows:
                drawn[f"{key}_noise"] = figures.draw_noise(rows["noise_spectra"])
            if "radial" in rows:
                drawn[f"{key}_uniformity"] = figures.draw_uniformity(rows["radial"], rows["angular"])
            if "slice_profile" in rows:
                fwhm = content["slice_profile"]["fwhm_mm"]
                drawn[f"{key}_slice_profile"] = figures.draw_slice_profile(rows["slice_profile"], fwhm)
    for module, series in found.content["noise_against_dose"].items():
        drawn[f"dose_{module}"] = figures.draw_dose(series)
    return drawn


def with_error(value: float | None, error: float | None) -> str:
    """Format a value and its standard error, to two significant digits of the error."""
    if value is None:
        return "not reached"
    if not error:
        return number(value)
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}".replace("-", "−")


def console_text(content: dict) -> str:
    """Return the main results as text, one line per recording and module."""
    lines = []
    for recording, entry in content["recordings"].items():
        for module, found in entry["modules"].items():
            parts = [f"{found['slices']} slices at z {found['z_mm'][0]:.1f} to {found['z_mm'][1]:.1f} mm"]
            if found["noise"]:
                parts.append(f"noise {number(found['noise']['sd_hu'])} HU")
            if sharp := [one["f50_per_mm"] for one in found["inserts"] if one["f50_per_mm"]]:
                parts.append(f"TTF 0.5 at {min(sharp):.2f} to {max(sharp):.2f} per mm")
            if found["hu"]:
                parts.append(f"HU within {number(found['hu']['rms_hu'])} HU (RMS) of a line")
            if found["uniformity"]:
                parts.append(f"cupping {found['uniformity']['cupping_hu']:+.1f} HU")
            if found["slice_profile"]:
                parts.append(f"slice profile {number(found['slice_profile']['fwhm_mm'])} mm")
            lines.append(f"{recording}, {module}: {', '.join(parts)}")
    return "\n".join(lines)
