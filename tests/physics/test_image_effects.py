"""An effect on images is added by one file in the effects folder."""

import shutil
from pathlib import Path

import numpy as np
from generators import effects as effects_page

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.physics import effect, effects
from virtual_phantom.simulation.reconstruct import apply_image_effects

NEW_EFFECT = """
from ..effect import Effect, Parameter


def apply(state, values):
    state.hu = state.hu.clip(max=values["ceiling_hu"])


EFFECT = Effect(
    name="{name}",
    physics="Numbers are cut.",
    equation="HU' = min(HU, c)",
    source="none",
    stage="image",
    signature="nothing over it",
    settled_by="metal",
    parameters=(Parameter("ceiling_hu", "HU", "largest number", 0.0, 1e4, 3000.0, 3000.0, None),),
    apply=apply,
    rank={rank},
)
"""


def test_effect_on_images_is_added_by_one_file(tmp_path, monkeypatch):
    """It is found, acts at its rank, is a candidate for images, and is listed in the catalog."""
    known = set(effect.image_effects())
    for path in Path(effects.__path__[0]).glob("*.py"):
        shutil.copy(path, tmp_path)
    for name, rank in (("cut_before", 0), ("cut_after", 2)):
        (tmp_path / f"{name}.py").write_text(NEW_EFFECT.format(name=name, rank=rank))
    monkeypatch.setattr(effects, "__path__", [str(tmp_path)])
    image, added = np.array([[[0.0, 40.0, 80.0]]]), {"hu_calibration": {"scale": 1.0, "offset_hu": 30.0}}
    before = apply_image_effects(image, (1.0, 1.0, 1.0), added | {"cut_before": {"ceiling_hu": 50.0}})
    after = apply_image_effects(image, (1.0, 1.0, 1.0), {"cut_after": {"ceiling_hu": 50.0}} | added)
    np.testing.assert_array_equal([before.ravel(), after.ravel()], [[30, 70, 80], [30, 50, 50]])
    assert set(effect.image_effects()) == known | {"cut_before", "cut_after"}
    settings = from_mapping(RecordingSettings, {"nominal_photons": 1e5})
    assert {"cut_before", "cut_after"} <= set(candidates(settings, "images"))
    assert not {"cut_before", "cut_after"} & set(candidates(settings))
    assert "## Cut before" in effects_page.page()
