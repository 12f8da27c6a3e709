"""Materials of a printed phantom against NIST's tables of mass attenuation (Hubbell and Seltzer, SRD 126)."""

import pytest

from virtual_phantom.physics.beam.material_names import COMPOUNDS, ELEMENTS, SYNONYMS, library_name
from virtual_phantom.physics.beam.materials import Mixture, attenuation_per_mm


def test_cellulose_attenuates_like_its_elements():
    # cm2/g at 60 keV of H, C and O, and their mass fractions in C6H10O5; 1.42 g/cm3.
    expected = 0.0622 * 0.3260 + 0.4445 * 0.1753 + 0.4934 * 0.1907
    assert attenuation_per_mm("cellulose", [60.0])[0] == pytest.approx(expected * 1.42 / 10, rel=0.01)


def test_potassium_iodide_has_the_k_edge_of_iodine():
    # Iodine at 33.1694 keV: 6.553 and 35.82 cm2/g below and above; its mass fraction is 0.7645. 3.13 g/cm3.
    below, above = attenuation_per_mm("potassium_iodide", [33.16, 33.18])
    assert above - below == pytest.approx(0.7645 * (35.82 - 6.553) * 3.13 / 10, rel=0.02)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("PMMA", "pmma"),
        ("Acrylic", "pmma"),
        ("Plexiglass", "pmma"),
        ("perspex", "pmma"),
        ("Aluminum", "aluminium"),
        ("Soft tissue", "soft_tissue"),
        ("potassium-iodide", "potassium_iodide"),
    ],
)
def test_common_names_of_materials_are_accepted(written, meant):
    assert library_name(written) == meant
    assert attenuation_per_mm(written, [60.0])[0] == attenuation_per_mm(meant, [60.0])[0]


def test_user_or_unknown_material_keeps_its_name():
    user_material = Mixture("PMMA", 1.0, "C2H4")
    assert (
        library_name(user_material) is user_material
        and library_name("Delrin") == "Delrin"
        and library_name("") == ""
        and library_name(7) == 7
    )
    known = {*COMPOUNDS, *ELEMENTS}
    assert (
        {library_name(name) for name in known} == known
        and set(SYNONYMS.values()) <= known
        and not set(SYNONYMS) & known
    )
