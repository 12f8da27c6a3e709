"""Table of the agreement of reconstructed images, for the report of a diagnosis."""

from __future__ import annotations

from ..figures import style
from .html import render

ALGORITHMS = {"fbp": "filtered back-projection", "sirt": "SIRT"}
NAMES = {
    "contrast": "contrast",
    "noise_magnitude": "noise magnitude (SD)",
    "noise_texture": "noise texture (mean frequency)",
    "noise_spectrum": "shape of the noise power spectrum (RMS)",
    "resolution": "resolution (frequency at MTF 0.5)",
    "features": "features within one repeat SD",
}


def agreement_table(table: dict | None) -> str:
    """Format the table of images in diagnosis.json as HTML; an empty string for None."""
    if table is None:
        return ""
    filters = {"quantity": _quantity, "compared": _compared, "floor": _floor, "short": style.number}
    filters["algorithm"] = ALGORITHMS.__getitem__
    return render("agreement_of_images", filters, table=table, names=NAMES)


def _quantity(value: float | None, unit: str) -> str:
    if value is None:
        return ""
    return f"{100 * value:.0f} %" if unit == "share" else f"{style.number(value)} {unit}"


def _compared(column: dict, unit: str) -> str:
    value, relative = _quantity(column["value"], unit), column["relative_difference"]
    if relative is None:
        return value
    difference = f"{style.number(100 * relative)} %"
    return f"{value} ({difference})" if value else difference


def _floor(metric: dict) -> str:
    if metric["floor"] is None:
        return ""
    if metric["unit"] == "share":
        return f"{100 * metric['floor']:.0f} %"
    signed = "±" if metric["recorded"] is not None else ""
    return f"{signed}{style.number(100 * metric['floor'])} %"
