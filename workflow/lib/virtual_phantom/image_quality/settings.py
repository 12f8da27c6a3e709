"""Section `image_quality` of the configuration."""

from __future__ import annotations

from dataclasses import dataclass

from ..diagnosis.settings import ShapesObject


@dataclass(frozen=True)
class ModuleSettings:
    """Section image_quality.<name>.modules.<module>: an object of shapes, and the slices that show it."""

    object: ShapesObject | None = None
    z_mm: tuple[float, ...] | None = None


@dataclass(frozen=True)
class ImageQualitySettings:
    """Section image_quality.<name>: recordings of one phantom, which may differ in dose."""

    recordings: tuple[str, ...]
    modules: dict[str, ModuleSettings]
