"""Candidate effects of a recording."""

from types import SimpleNamespace

import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.candidate_effects import candidate_conditions, candidates, check_accuracy, check_kinds
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.physics.effect import acts_on_images, applicable_effects, names


def stated(**settings):
    return from_mapping(RecordingSettings, settings)


def test_photon_flux_is_a_candidate_only_with_declared_photons():
    assert "photon_flux" in candidates(stated(nominal_photons=1e5))
    assert set(candidates(stated())) == set(candidates(stated(nominal_photons=1e5))) - {"photon_flux"}


def test_each_kind_of_data_has_its_candidates():
    offered_names = {kind: set(candidates(stated(nominal_photons=1e5), kind)) for kind in ("projections", "images")}
    of_images = {name for name in names() if acts_on_images(name)}
    assert set(names()) - offered_names["projections"] == of_images | {"water_correction", "current_along_z"}
    assert set(names()) - offered_names["images"] == {"gain_pattern", "water_correction", "current_along_z"}


def test_vendor_corrections_are_candidates_for_corrected_data_only():
    tried = candidates(stated(), corrected=["beam_hardening"])
    assert "water_correction" in tried and "spectrum" not in tried
    with pytest.raises(InputError, match=r"water_correction .* state corrected: \[beam_hardening\] in recording.yaml"):
        candidates(stated(effects=["water_correction"]))


def test_tube_current_along_z_needs_a_source_that_moves_along_z():
    scan = {"trajectory": "helical", "rotation_time_ms": 500.0, "views_per_rotation": 100.0}
    assert "current_along_z" in candidates(stated(), **candidate_conditions({"kind": "projections", "scan": scan}))
    assert "current_along_z" in candidates(stated(), **candidate_conditions({"kind": "images"}))
    circle = scan | {"trajectory": "circular"}
    assert "current_along_z" not in candidates(
        stated(), **candidate_conditions({"kind": "projections", "scan": circle})
    )


def test_effects_without_effect_alone_are_candidates_with_the_effects_they_modify():
    every = ["anti_scatter_grid", "slow_afterglow", "motion"]
    assert applicable_effects(every, ()) == ["motion"]
    assert applicable_effects(every, ("scatter",)) == ["anti_scatter_grid", "motion"]


@pytest.mark.parametrize(
    ("effects", "kind", "message"),
    [
        (["glow"], "projections", "there is no effect 'glow'"),
        (["slice_thickness"], "projections", "slice_thickness acts on images"),
        (["gain_pattern"], "images", "gain_pattern has one unknown per detector pixel"),
        (["scatter", "photon_flux"], "projections", "photon_flux is relative to nominal_photons"),
    ],
)
def test_impossible_candidates_are_rejected(effects, kind, message):
    with pytest.raises(InputError, match=message) as error:
        candidates(stated(effects=effects), kind)
    assert "\n" not in str(error.value)


def test_model_accuracy_is_accepted_for_known_effects_only():
    check_accuracy({"default": 0.02, "numerical": 0.1, "spectrum": 0.0})
    with pytest.raises(InputError, match="diagnosis.model_accuracy: there is no effect 'glow'"):
        check_accuracy({"default": 0.02, "glow": 0.1})


def test_disc_that_contains_the_source_is_rejected():
    def check(diameter_mm, **scan):
        content = {"kind": "projections", "scan": scan}
        disc = stated(disc={"diameter_mm": diameter_mm, "material": "water"})
        check_kinds({"bench": disc}, {"bench": SimpleNamespace(content=content)})

    message = "bench.disc.diameter_mm is 1000, but the source is 500 mm from the isocenter, within the disc"
    with pytest.raises(InputError, match=message):
        check(1000, source_to_isocentre_mm=500)
    check(999, source_to_isocentre_mm=500)
    check(1000, source_to_isocentre_mm=500, length_unit="element")
    check(1000, beam="parallel")


def test_transferred_physics_must_come_from_the_same_kind_of_data():
    kinds = {"bench": "projections", "scanner": "images"}
    recordings = {name: SimpleNamespace(content={"kind": kind}) for name, kind in kinds.items()}
    diagnosed = {"scanner": stated(protocol="fbp_300"), "bench": stated(physics_from="scanner")}
    with pytest.raises(InputError, match="bench.physics_from is 'scanner', which holds images, not projections"):
        check_kinds(diagnosed, recordings)
