"""Which effects a recording is tried against."""

from types import SimpleNamespace

import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.candidates import candidates, check_accuracy, check_kinds
from virtual_phantom.physics.effect import acts_on_images, names


def test_a_flux_is_only_tried_against_a_stated_one():
    assert "photon_flux" in candidates({"nominal_photons": 1e5})
    assert set(candidates({})) == set(candidates({"nominal_photons": 1e5})) - {"photon_flux"}


def test_each_kind_has_its_own():
    ours = {kind: set(candidates({"nominal_photons": 1e5}, kind)) for kind in ("projections", "images")}
    assert set(names()) - ours["projections"] == {name for name in names() if acts_on_images(name)}
    assert set(names()) - ours["images"] == {"gain_pattern"}


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
        candidates({"effects": effects}, kind)
    assert "\n" not in str(error.value)


def test_exactness_is_of_effects_that_there_are():
    check_accuracy({"default": 0.02, "numerical": 0.1, "spectrum": 0.0})
    with pytest.raises(InputError, match="diagnosis.model_accuracy: there is no effect 'glow'"):
        check_accuracy({"default": 0.02, "glow": 0.1})


def test_physics_comes_from_a_recording_of_the_same_kind():
    kinds = {"bench": "projections", "scanner": "images"}
    recordings = {name: SimpleNamespace(content={"kind": kind}) for name, kind in kinds.items()}
    diagnosed = {"scanner": {"protocol": "fbp_300"}, "bench": {"physics_from": "scanner"}}
    with pytest.raises(InputError, match="bench.physics_from is 'scanner', which holds images, not projections"):
        check_kinds(diagnosed, recordings)
