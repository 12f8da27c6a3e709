"""Hidden effects of a suite: reproducible from its seed, and only contained in the truth."""

import ast
from collections import Counter
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.config import read_study
from virtual_phantom.physics.effect import acts_on_images, load, names
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.catalogue import (
    CATALOGUE,
    DEFINED_OTHERWISE,
    GVXR,
    MODELS,
    OTHER,
    OWN,
    SIMULATED,
    SIMULATORS,
    equation,
    never_hidden,
    simulated_by,
)
from virtual_phantom.proof.hiding.generate import scan_of, write, write_images
from virtual_phantom.proof.hiding.imperfections import DECLARABLE, HU_ERROR
from virtual_phantom.proof.hiding.missing_effects import MISSING_EFFECTS
from virtual_phantom.proof.hiding.objects import DISC, KINDS
from virtual_phantom.proof.hiding.orbits import GEOMETRIES, Orbit, image_grid
from virtual_phantom.proof.hiding.suite import KERNEL, KNOWN, World, cases, check_tried, salt, truths, worlds
from virtual_phantom.proof.hiding.xcist import Acquired
from virtual_phantom.recordings.reading import load_recording

SETTINGS = {
    "seed": 7,
    "simulators": ["xcist"],
    "declared": 2,
    "strengths": ["weak", "medium", "strong"],
    "none": 8,
    "pairs": 30,
    "unknown": 8,
    "images": {"strengths": ["medium", "strong"], "effects": ["hu_calibration", "scatter", "motion"], "views_times": 4},
    "scan": {"views": 72, "columns": 64, "rows": 6, "photons": 1e5, "rotation_time_ms": 1000, "repeats": 4},
    "held_out_protocol": {"views": 60, "photons": 5e4, "rotation_time_ms": 500, "repeats": 4},
}
SETTINGS["images"]["tried"] = ["reconstruction_kernel", *SETTINGS["images"]["effects"]]
ORBIT = Orbit(30, 40, 4, 5.0, 5.0, 541.0, 949.0)
NIFTI_HEADER = 352  # bytes before the voxels
IMAGES = {"single": 2, "pair": 3}
LIBRARY = Path(seal.__file__).resolve().parents[1]


def section(settings):
    return from_mapping(ProofSettings, settings)


@pytest.fixture(scope="module")
def suite():
    return truths(section(SETTINGS))


def test_every_effect_on_projections_can_be_hidden_at_every_strength(suite):
    assert set(KNOWN) == {name for name in names() if not acts_on_images(name)} - set(never_hidden())
    lines = [t for t in suite.values() if t["kind"] == "projections"]
    singles = Counter((t["effects"][0]["name"], t["strength"]) for t in lines if t["category"] == "single")
    assert singles == {(name, strength): 1 for name in KNOWN for strength in SETTINGS["strengths"]}
    assert Counter(t["category"] for t in lines) == {"single": 75, "none": 8, "pair": 30, "unknown": 8}


def test_every_image_has_another_kernel_and_some_another_effect(suite):
    images = {case: t for case, t in suite.items() if t["kind"] == "images"}
    known = worlds(section(SETTINGS))
    assert (
        list(images) == cases(section(SETTINGS))[-5:] == [case for case, one in known.items() if one.kind == "images"]
    )
    assert Counter(t["category"] for t in images.values()) == IMAGES
    assert {t["effects"][0]["name"] for t in images.values()} == {KERNEL}
    assert {t["effects"][1]["name"] for t in images.values() if len(t["effects"]) > 1} == {
        *SETTINGS["images"]["effects"]
    }
    for case in images:
        orbits = known[case].orbits(section(SETTINGS))
        assert [orbit.views for orbit in orbits] == [288, 240] and all(orbit.turns == 1 for orbit in orbits)
    # The projections of a seed do not depend on images.
    without = SETTINGS | {"images": SETTINGS["images"] | {"strengths": [], "effects": []}}
    assert truths(section(without)).items() <= suite.items()


def test_suite_is_reproducible_from_its_seed(suite):
    assert truths(section(SETTINGS)) == suite
    assert truths(section(SETTINGS | {"seed": 8})) != suite
    assert len({salt(7, number) for number in range(100)}) == 100


def test_order_of_cases_contains_no_information(suite):
    singles = [t["effects"][0]["name"] for t in suite.values() if t["category"] == "single" and t["kind"] != "images"]
    assert singles != sorted(singles, key=KNOWN.index)
    assert len({t["category"] for t in list(suite.values())[:20]}) > 1
    assert list(suite) == cases(section(SETTINGS))


@pytest.mark.parametrize("seed", range(5))
def test_effects_are_hidden_where_the_object_shows_them(seed):
    """A disc shows no wrong angle, and an object that is constant along z no displaced row."""
    found = truths(
        section(SETTINGS | {"seed": seed, "pairs": 60, "unknown": 28, "simulators": ["xcist", "gvirtualxray"]})
    )
    for one in found.values():
        for effect in one["effects"]:
            assert not {one["object"], one["description"]} & set(CATALOGUE[effect["name"]].unseen)
    singles = Counter(one["effects"][0]["name"] for one in found.values() if one["category"] == "single")
    assert singles["view_blur"] == singles["detector_row_offset"] == 6
    assert any(one["description"] == DISC for one in found.values() if one["category"] == "single")


def test_effects_of_pairs_are_of_different_groups(suite):
    for one in suite.values():
        if one["category"] == "pair":
            first, second = (CATALOGUE[effect["name"]].alike for effect in one["effects"])
            assert not first or first != second


def test_comparable_parameters_are_those_of_the_library_and_plausible(suite):
    for one in suite.values():
        for effect in one["effects"]:
            if effect["known"]:
                ranges = {p.name: (p.low, p.high) for p in load(effect["name"]).parameters}
                for name, value in effect["comparable"].items():
                    low, high = ranges[name]
                    assert low <= value <= high, (effect["name"], name, value)


def test_truths_can_be_sealed(suite):
    documents = [seal.sealed(truth, salt(7, truth["number"])) for truth in suite.values()]
    assert len(set(seal.publish(documents).values())) == len(suite)


def test_unknown_effect_is_rejected():
    with pytest.raises(InputError, match=r"proof.effects: 'scater' cannot be hidden"):
        cases(section(SETTINGS | {"effects": ["scater"]}))
    for name in ("scater", KERNEL, "periodic_motion"):
        with pytest.raises(
            InputError, match=rf"proof.images.effects: '{name}' cannot be hidden together with a kernel"
        ):
            cases(section(SETTINGS | {"images": {"strengths": [], "effects": [name], "tried": [KERNEL, name]}}))
    with pytest.raises(InputError, match=r"proof.images.tried: lacks 'scatter'"):
        check_tried(
            section(SETTINGS | {"images": SETTINGS["images"] | {"tried": [KERNEL, "hu_calibration", "motion"]}})
        )
    with pytest.raises(InputError, match=r"proof.tried: lacks 'scatter'"):
        check_tried(section(SETTINGS | {"effects": ["motion", "scatter"], "tried": ["motion", "scaler"], "pairs": 0}))
    with pytest.raises(InputError, match=r"proof.scan.rows: 4 rows cover too few slices"):
        cases(section(SETTINGS | {"scan": SETTINGS["scan"] | {"rows": 4}}))


def test_truth_states_the_simulator_that_makes_the_case():
    """gVirtualXray cannot hide a filter with a K edge: XCIST makes and is recorded for every such case."""
    plain = SETTINGS | {"none": 0, "pairs": 0, "strengths": [], "images": SETTINGS["images"] | {"effects": []}}
    plain["images"] |= {"strengths": []}

    def simulators(**changed):
        drawn = truths(section(plain | changed)).values()
        return {(truth["effects"][0]["name"], truth["simulator"]) for truth in drawn}

    both = [GVXR, "xcist"]
    kinds = ["k_edge_filter", "wrong_insert"]
    made = {("k_edge_filter", "xcist"), ("wrong_insert", "xcist"), ("wrong_insert", GVXR)}
    assert simulators(simulators=both, unknown_kinds=kinds) == made
    assert simulators(simulators=[GVXR], unknown=len(MISSING_EFFECTS)) == {
        (name, GVXR) for name in MISSING_EFFECTS if name != "k_edge_filter"
    }
    with pytest.raises(InputError, match="proof.unknown_kinds: gvirtualxray cannot hide 'k_edge_filter'; add xcist"):
        simulators(simulators=[GVXR], unknown_kinds=kinds)


OF_ITS_OWN = ("readout", "generate", "faults", "unsteady", "changed_object")


def test_origin_of_equations():
    """Effects of XCIST are those whose settings no callback and no readout of the blind validation reads."""
    assert sorted(name for made in MODELS.values() for name in made) == sorted(CATALOGUE)
    actual = set()
    folder = LIBRARY / "hiding"
    for path in [*(folder / "hooks").glob("*.py"), *(folder / f"{one}.py" for one in OF_ITS_OWN)]:
        for node in ast.walk(ast.parse(path.read_text())):
            actual |= {node.attr} if isinstance(node, ast.Attribute) else set()
            actual |= {node.value} if isinstance(node, ast.Constant) and isinstance(node.value, str) else set()
    for name, one in CATALOGUE.items():
        settings, _ = one.draw("strong", np.random.default_rng(1))
        if name == "photon_flux":  # the imperfections have a factor, too
            continue
        assert bool(actual & set(settings)) == (name not in MODELS[SIMULATED]), (name, settings)
    assert len(MODELS[OWN]) == 3 and {equation(name, GVXR) for name in KNOWN} == {SIMULATED, OTHER, OWN}


@pytest.fixture(scope="module")
def both():
    settings = section(SETTINGS | {"simulators": list(SIMULATORS), "none": 40, "unknown": 28})
    return settings, truths(settings)


def test_both_simulators_hide_what_they_have(both):
    settings, suite = both
    lines = [t for t in suite.values() if t["kind"] == "projections"]
    for simulator in SIMULATORS:
        here = [t for t in lines if t["simulator"] == simulator]
        assert all(simulated_by(effect["name"], simulator) for t in here for effect in t["effects"])
        count = 3 * sum(simulated_by(name, simulator) for name in KNOWN)
        assert Counter(t["category"] for t in here)["single"] == count
        assert {t["geometry"] for t in here} == set(GEOMETRIES) - ({"arc"} if simulator == GVXR else set())
        assert {t["object"] for t in here} == set(KINDS)
    for case, world in worlds(settings).items():
        assert World.of(suite[case]) == world


def test_objects_are_new_in_every_case_and_parts_do_not_overlap(both):
    settings, suite = both
    seen = set()
    for world in list(worlds(settings).values())[:40]:
        scanned = world.stated(settings.seed)
        assert scanned == world.stated(settings.seed) and scanned not in seen
        seen.add(scanned)
        outer, *inner = scanned.parts
        assert not (world.description == DISC and inner)
        for number, part in enumerate(inner):
            x, y, _ = part.centre_mm
            assert outer.shape.level(0.0, y, x) < -part.radius_mm
            for other in inner[:number]:
                apart = np.hypot(x - other.centre_mm[0], y - other.centre_mm[1])
                assert apart > part.radius_mm + other.radius_mm + 1


def test_imperfections_are_small_and_stated_values_are_near_the_truth(both):
    _, suite = both
    drawn = [t["imperfections"] for t in suite.values()]
    assert all(abs(hu) <= HU_ERROR for one in drawn for hu in one["object"].values())
    assert all(0.1 <= abs(mm) <= 0.3 for one in drawn for mm in one["shape_mm"].values())
    off = []
    for truth, one in zip(suite.values(), drawn, strict=True):
        hidden = {effect["name"] for effect in truth["effects"]}
        assert not hidden & {*one["declared"], *one["undeclared"]} and set(one["declared"]) == set(one["stated"])
        otherwise = DEFINED_OTHERWISE[truth["simulator"]]
        assert set(one["declared"]) <= set(DECLARABLE) - {*otherwise}
        assert not any(effect["comparable"] for effect in truth["effects"] if effect["name"] in otherwise)
        for name, values in one["declared"].items():
            assert set(values) == {parameter.name for parameter in load(name).parameters}
            off += [
                (one["stated"][name][key]["value"] - true) / one["stated"][name][key]["sd"]
                for key, true in values.items()
                if true
            ]
    assert len(off) > 100 and abs(np.mean(off)) < 0.4 and 0.7 < np.std(off) < 1.3
    assert 0.1 < np.mean([bool(one["undeclared"]) for one in drawn]) < 0.4


def test_recordings_differ_in_readings_only(tmp_path):
    """Same keys, attributes and sizes, whatever is hidden."""
    documents, sizes = [], []
    random = np.random.default_rng(1)
    for name in ("plain", "other"):
        readings = random.uniform(1, 2, (2, 30, 4, 40)).astype(np.float32)
        write(tmp_path / name, "case_01", ORBIT, 800.0, Acquired(readings, np.full((4, 40), 2, np.float32)), 0.0193)
        recording = load_recording(tmp_path / name)
        assert len(recording.repeats) == 2 and recording.geometry.views == 30
        assert recording.geometry.duration_s == pytest.approx(0.8) and recording.geometry.exposure_ms == 0
        documents.append(yaml.safe_load((tmp_path / name / "recording.yaml").read_text()))
        sizes.append([path.stat().st_size for path in sorted((tmp_path / name).glob("*.h5"))])
        with h5py.File(tmp_path / name / "scan01.h5") as file:
            reported = []
            file.visititems(lambda path, item, reported=reported: reported.append((path, dict(item.attrs))))
            documents[-1]["file"] = reported
    assert documents[0] == documents[1] and sizes[0] == sizes[1]


def test_images_contain_no_information_but_their_voxels(tmp_path):
    documents, headers = [], []
    orbit, random = replace(ORBIT, views=24, columns=60, rows=6), np.random.default_rng(1)
    for name, hidden in (("plain", {}), ("other", {"kernel_pixels": 1.0, "hu_scale": 1.1, "hu_offset": 20.0})):
        scan = scan_of(orbit, 1e5, 800.0, 70.0, hidden)
        readings = random.uniform(1, 2, (2, 24, 6, 60)).astype(np.float32)
        readings[0, 0, 0, 0] = 0  # zero counts have no logarithm
        taken = Acquired(readings, np.full((6, 60), 2, np.float32))
        write_images(tmp_path / name, "case_01", image_grid(orbit), scan, taken, 0.0193)
        recording = load_recording(tmp_path / name)
        assert recording.kind == "images" and len(recording.repeats) == 2
        assert all(np.isfinite(image.array).all() for image in recording.repeats)
        documents.append((tmp_path / name / "recording.yaml").read_text())
        headers.append([path.read_bytes()[:NIFTI_HEADER] for path in sorted((tmp_path / name).glob("*.nii"))])
    assert documents[0] == documents[1] and headers[0] == headers[1] and len(headers[0]) == 2


def test_quick_set_has_fifteen_cases_of_every_kind():
    config = Path(__file__).resolve().parents[2] / "config"
    whole, quick = (yaml.safe_load((config / f"{name}.yaml").read_text()) for name in ("config", "quick_proof"))
    hidden = truths(read_study(whole | quick).proof)
    assert len(hidden) == 15
    kinds = Counter(one["category"] for one in hidden.values())
    assert kinds == {"single": 10, "none": 2, "pair": 2, "unknown": 1}
