"""Which effects a recording is tried against."""

from types import SimpleNamespace

import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.candidate_effects import candidates, check_accuracy, check_kinds, shown_by
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.physics.effect import acts_on_images, names, offered


def stated(**settings):
    return from_mapping(RecordingSettings, settings)


def test_a_flux_is_only_tried_against_a_stated_one():
    assert "photon_flux" in candidates(stated(nominal_photons=1e5))
    assert set(candidates(stated())) == set(candidates(stated(nominal_photons=1e5))) - {"photon_flux"}


def test_each_kind_has_its_own():
    ours = {kind: set(candidates(stated(nominal_photons=1e5), kind)) for kind in ("projections", "images")}
    of_images = {name for name in names() if acts_on_images(name)}
    assert set(names()) - ours["projections"] == of_images | {"water_correction", "current_along_z"}
    assert set(names()) - ours["images"] == {"gain_pattern", "water_correction", "current_along_z"}


def test_a_correction_is_looked_for_where_the_maker_made_it():
    tried = candidates(stated(), corrected=["beam_hardening"])
    assert "water_correction" in tried and "spectrum" not in tried
    with pytest.raises(InputError, match=r"water_correction .* state corrected: \[beam_hardening\] in recording.yaml"):
        candidates(stated(effects=["water_correction"]))


def test_a_current_along_the_axis_needs_a_source_that_moves_there():
    scan = {"trajectory": "helical", "rotation_time_ms": 500.0, "views_per_rotation": 100.0}
    assert "current_along_z" in candidates(stated(), **shown_by({"kind": "projections", "scan": scan}))
    assert "current_along_z" in candidates(stated(), **shown_by({"kind": "images"}))
    circle = scan | {"trajectory": "circular"}
    assert "current_along_z" not in candidates(stated(), **shown_by({"kind": "projections", "scan": circle}))


def test_what_does_nothing_alone_is_offered_beside_what_it_changes():
    every = ["anti_scatter_grid", "slow_afterglow", "motion"]
    assert offered(every, ()) == ["motion"]
    assert offered(every, ("scatter",)) == ["anti_scatter_grid", "motion"]


@pytest.mark.parametrize(
    ("effects", "kind", "message"),
    [
        (["glow"], "projections", "there is no effect 'glow'"),
        (["slice_thickness"], "projections", "slice_thickness acts on images"),
        (["gain_pattern"], "images", "gain_pattern has one unknown per detector pixel"),
        (["scatter", "photon_flux"], "projections", "photon_flux needs nominal_photons"),
    ],
)
def test_what_cannot_be_tried_is_refused(effects, kind, message):
    with pytest.raises(InputError, match=message) as error:
        candidates(stated(effects=effects), kind)
    assert "\n" not in str(error.value)


def test_exactness_is_of_effects_that_there_are():
    check_accuracy({"default": 0.02, "numerical": 0.1, "spectrum": 0.0})
    with pytest.raises(InputError, match="diagnosis.model_accuracy: there is no effect 'glow'"):
        check_accuracy({"default": 0.02, "glow": 0.1})


def test_physics_comes_from_a_recording_of_the_same_kind():
    kinds = {"bench": "projections", "scanner": "images"}
    recordings = {name: SimpleNamespace(content={"kind": kind}) for name, kind in kinds.items()}
    diagnosed = {"scanner": stated(protocol="fbp_300"), "bench": stated(physics_from="scanner")}
    with pytest.raises(InputError, match="bench.physics_from is 'scanner', which holds images, not projections"):
        check_kinds(diagnosed, recordings)
