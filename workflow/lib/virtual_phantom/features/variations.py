"""Extraction settings to compare on the same images: one setting at a time differs from those of the study.

Every start of the workflow reads this module, so it loads neither pyradiomics nor pandas. `parameters.vary` applies a
setting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..base.errors import InputError
from .names import LARGEST, WHOLE

if TYPE_CHECKING:
    from .settings import Extraction

FACTORS = ("bin_width", "bin_count", "resampled_mm", "dimensions")
UNRESAMPLED = "none"
IN_SLICES, IN_VOLUMES = "2d", "3d"
OWN = "study"  # name of the study's own settings
BINS = ("binWidth", "binCount")


@dataclass(frozen=True)
class Variation:
    """One setting that differs from the study's.

    Attributes
    ----------
    factor : str
        One of FACTORS.
    value : float or str
        As in `analyses.extraction`.
    """

    factor: str
    value: float | str

    @property
    def name(self) -> str:
        """Name in files and tables, such as bin_width_12p5."""
        value = self.value if isinstance(self.value, str) else f"{self.value:g}".replace(".", "p")
        return f"{self.factor}_{value}"

    def apply(self, own: Extraction, section: str) -> tuple[Extraction, str]:
        """Return the study's own settings and section with this setting changed.

        Raises
        ------
        InputError
            If an image type of the parameter file has its own bins, which would override the setting.
        """
        settings = dict(own.settings)
        if self.factor in ("bin_width", "bin_count"):
            for name, stated in own.image_types.items():
                if set(BINS) & set(stated or {}):
                    raise InputError(
                        f"features.parameters: imageType.{name} has its own bins, and analyses.extraction varies "
                        f"{self.factor}; move them to setting, or remove {self.factor}"
                    )
            settings.pop("binCount", None)
            settings["binWidth" if self.factor == "bin_width" else "binCount"] = self.value
        elif self.factor == "resampled_mm":
            settings["resampledPixelSpacing"] = self._spacing(settings, section)
        else:
            section = LARGEST if self.value == LARGEST else WHOLE
            settings["force2D"] = self.value == IN_SLICES
            if spacing := settings.get("resampledPixelSpacing"):
                settings["resampledPixelSpacing"] = [*spacing, 0][: 2 if section == LARGEST else 3]
        return replace(own, settings=settings), section

    def _spacing(self, settings: Mapping, section: str) -> list[float] | None:
        """Return the spacing (x, y, z) along the axes of the textures; 0 keeps an axis as it is."""
        if self.value == UNRESAMPLED:
            return None
        spacing = [self.value] * (2 if section == LARGEST else 3)
        if settings.get("force2D") and section == WHOLE:
            spacing[2 - settings.get("force2Ddimension", 0)] = 0
        return spacing


def variations(values: Mapping[str, Sequence | None], own: Extraction, section: str) -> dict[str, Variation]:
    """Return {name: variation} of all values that differ from the study's own settings, in the order of FACTORS.

    Parameters
    ----------
    values : mapping of str to sequence
        {factor: values}, from `analyses.extraction`.
    own : Extraction
        The study's settings.
    section : {"whole", "largest"}
        The study's section of each region.
    """
    found = [Variation(factor, value) for factor in FACTORS for value in values.get(factor) or ()]

    def effect(variation: Variation) -> tuple:
        extraction, chosen = variation.apply(own, section)
        effective = extraction.effective()
        if chosen == LARGEST:
            effective = {key: value for key, value in effective.items() if not key.startswith("force2D")}
        return effective, chosen

    unchanged = effect(Variation("dimensions", LARGEST)) if section == LARGEST else (own.effective(), section)
    return {variation.name: variation for variation in found if effect(variation) != unchanged}
