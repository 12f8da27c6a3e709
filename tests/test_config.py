"""Configuration: defaults, overlays, and one clear line for every mistake."""

import copy
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from snakemake.utils import update_config
from workflow_runs import BENEATH

from virtual_phantom.base.console import collected_notes
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import grid_of, scan_geometry
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.config import check, complete, read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.config.settings import Study
from virtual_phantom.statistics.measured import TISSUE_CLASSES

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = ROOT / "workflow" / "lib" / "virtual_phantom"
DEFAULT = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())

NOISE_KERNEL = {"mtf50_per_cm": 2.0, "mtf10_per_cm": 4.4, "variance": 0.5}
MEETS = {"recording": "scanner", "rois": ["cyst_1"], "protocol": "sirt_300"}
COMPARISON = {"recording": "scanner", "protocol": "sirt_300", "noise": "dose10"}


def changed(path, value):
    """The default configuration with the key at a dotted path set to a value."""
    config = copy.deepcopy(DEFAULT)
    section = config
    *parents, last = path.split(".")
    for key in parents:
        section = section.setdefault(key, {})
    section[last] = value
    return config


def refuse(config, message):
    """Check that both functions reject the configuration and leave it unchanged."""
    before = copy.deepcopy(config)
    for function in (check, complete):
        with pytest.raises(InputError) as error:
            function(config)
        assert message in str(error.value)
        assert "\n" not in str(error.value)
        assert config == before


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "config").glob("*.yaml")))
def test_checking_and_completing_change_nothing(name):
    """For every shipped configuration with effects, whose defaults are completed too."""
    files = (*BENEATH.get(f"{name}.yaml", ()), f"{name}.yaml")
    lines, config = read_configs([ROOT / "config" / file for file in files])
    assert not lines
    config |= {"physics": {"scatter": None, "reconstruction_kernel": {"sigma_mm": 1.0}}, "measured": {"overlay": False}}
    config["noise"]["model"] = "physical"
    boxed = {name for name, protocol in config["protocols"].items() if protocol and "voxels" in protocol}
    for one in boxed:  # images have no effects in this configuration
        config["protocols"][one]["physics"] = {"scatter": None}
    before = copy.deepcopy(config)
    assert check(config) and config == before
    whole = complete(config)
    assert config == before
    assert whole["protocols"]
    for one, protocol in whole["protocols"].items():
        assert protocol["physics"]["scatter"]["amount"] > 0
        kernel = {"sigma_mm": 1.0, "shape": 0.0, "boost": 0.0, "boost_per_cm": 3.0}
        assert protocol["image_physics"] == ({} if one in boxed else {"reconstruction_kernel": kernel})
    # The two share no mutable values.
    for protocol in whole["protocols"].values():
        protocol["physics"].clear()
    whole["noise"]["levels"].clear()
    assert config == before and complete(config)["noise"]["levels"]


def test_defaults_are_filled_in():
    config = complete(DEFAULT)
    assert config["seed"] == 2022
    assert config["reconstruction"] == {
        "sirt": {"iterations": 500, "solver": "chebyshev", "terms": 75, "backprojector": "adjoint", "tolerance_hu": 1},
        "fbp": {"normalise": "coverage"},
    }
    assert config["scan"]["trajectory"] == "helical"
    assert complete(config) == config
    assert "seed" not in DEFAULT


def test_iterative_image_may_be_fbp_with_a_noise_kernel():
    kernel = {"mtf50_per_cm": 2.98, "mtf10_per_cm": 5.06}
    protocol = {"algorithm": "fbp", "projections": 150, "kernel": kernel, "noise_kernel": NOISE_KERNEL}
    config = changed("protocols.proxy", protocol)
    config["analyses"] |= {"optimal": {"sirt": "proxy", "fbp": "fbp_150", "noise": "dose10"}}
    assert complete(config)["analyses"]["optimal"]["sirt"] == "proxy"
    config["protocols"]["proxy"] = protocol | {"voxels": {"spacing_mm": [2.0, 1.0, 1.0], "thickness_mm": 2.0}}
    refuse(config, "analyses.optimal.sirt")


def test_comparison_and_diagnosed_recording_have_different_names():
    config = changed("analyses.comparison", {"scanner": COMPARISON})
    config["recordings"] = {"scanner": "somewhere"}
    config["diagnosis"] = {"comparisons": ["scanner"]}
    assert complete(config)["diagnosis"]["comparisons"] == ["scanner"]
    config["diagnosis"]["recordings"] = {"scanner": {}}
    refuse(config, "diagnosis.comparisons and diagnosis.recordings both have 'scanner'")


def test_key_attribute_is_deprecated():
    old = changed("analyses.comparison", {"near": COMPARISON | {"attribute": True}})
    old["recordings"] = {COMPARISON["recording"]: "somewhere"}
    new = changed("analyses.comparison", {"near": COMPARISON})
    new |= {"recordings": old["recordings"], "diagnosis": {"comparisons": ["near"]}}
    with collected_notes() as notes:
        assert complete(old) == complete(new)
    assert [str(note) for note in dict.fromkeys(notes)] == [
        "config: analyses.comparison.near.attribute is deprecated; name near in diagnosis.comparisons and run "
        "`snakemake diagnosis`"
    ]
    old["analyses"]["comparison"]["near"]["attribute"] = False
    assert complete(old)["diagnosis"]["comparisons"] == []
    old["analyses"]["comparison"]["near"]["attribute"] = "yes"
    refuse(old, "analyses.comparison.near.attribute")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "protocols.fbp_300.voxels",
            {"spacing_mm": [2, 1, 1], "thickness_mm": 2},
            "analyses.stability.noise_control: protocol fbp_300 has its own voxels; remove noise_control, or voxels",
        ),
        ("noise.levels.dose10.repeats", 2, "analyses.stability.noise_control needs at least 3 for the variance"),
    ],
)
def test_control_with_white_noise_needs_the_grid_of_the_study_and_repeats(key, value, message):
    config = changed(key, value)
    config["analyses"]["stability"]["noise_control"] = True
    refuse(config, message)


SCANNED = {name: {} for name in ("a", "b", "c", "scanners")}


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"protocols": {"SIRT_300": DEFAULT["protocols"]["sirt_300"]}}, "protocols: sirt_300 and SIRT_300 differ only"),
        ({"noise": {"levels": {"Dose10": {"A": 1e-6, "repeats": 3}}}}, "noise.levels: dose10 and Dose10 differ only"),
        (
            {
                "protocols": {"sirt_300_without_physics": {"algorithm": "sirt", "projections": 300}},
                "physics": {"scatter": None},
                "analyses": {"stability": {"without_physics": True}},
            },
            "analyses.stability.without_physics makes a protocol of this name from sirt_300; rename it",
        ),
        ({"recordings": {"a": "x", "A": "y"}}, "recordings: a and A differ only in case"),
        (
            {"analyses": {"comparison": dict.fromkeys(("a", "a_features"), COMPARISON)}},
            "analyses.comparison.a and analyses.comparison.a_features both write to tables/comparison_a_features.csv",
        ),
        (
            {"analyses": {"comparison": dict.fromkeys(("b_families", "b"), COMPARISON)}},
            "analyses.comparison.b and analyses.comparison.b_families both write to tables/comparison_b_families.csv",
        ),
        (
            {"diagnosis": {"recordings": SCANNED, "scanners": {"next_measurement": {"recordings": ["a", "b", "c"]}}}},
            "diagnosis.recordings.scanners and diagnosis.scanners.next_measurement both write to "
            "diagnosis/scanners/next_measurement",
        ),
        (
            {"diagnosis": {"recordings": SCANNED, "scanners": {"maps": {"recordings": ["a", "b", "c"]}}}},
            "diagnosis.recordings.scanners and diagnosis.scanners.maps both write to diagnosis/scanners/maps",
        ),
    ],
)
def test_names_of_the_same_file_are_rejected(changes, message):
    config = copy.deepcopy(DEFAULT)
    update_config(config, {"recordings": {**dict.fromkeys(SCANNED, "x"), "scanner": "y"}})
    update_config(config, changes)
    refuse(config, f"{message}")


def test_similar_names_of_different_files_are_accepted():
    config = copy.deepcopy(DEFAULT)
    names = ("features", "index", "cells", "scanner", "a", "a_scores", "maps")
    config["recordings"] = dict.fromkeys(names, "x")
    config["analyses"]["comparison"] = dict.fromkeys(names, COMPARISON)
    config["diagnosis"] = {"recordings": dict.fromkeys(names, {}), "scanners": {"maps": {"recordings": ["a", "cells"]}}}
    check(config)


@pytest.mark.parametrize(
    "path, value, message",
    [
        ("diagnosis", {"recordings": {"bench": {}}}, "diagnosis.recordings names 'bench', which does not exist"),
        ("diagnosis", {"comparisons": ["x"]}, "diagnosis.comparisons names 'x', which does not exist"),
        ("diagnosis", {"recordings": {"bench": {"sample": 2}}}, "unknown key 'sample' in diagnosis.recordings.bench"),
        ("physics", {"scatter": {}}, "physics needs noise.model: physical"),
        ("scan.samples", 2, "scan.samples needs noise.model: physical"),
        ("reconstruct", {}, "unknown key 'reconstruct' in config; did you mean 'reconstruction'"),
        ("scan.pich", 1, "unknown key 'pich' in scan; did you mean 'pitch'"),
        ("protocols.sirt_150.projections", 0, "protocols.sirt_150.projections: 0 is less than the minimum of 1"),
        ("protocols.sirt_150.projections", -5, "protocols.sirt_150.projections: -5 is less than the minimum of 1"),
        ("protocols.sirt_150.projections", "many", "protocols.sirt_150.projections: 'many' is not of type 'integer'"),
        ("protocols.sirt_150.algorithm", "art", "protocols.sirt_150.algorithm is 'art'; use one of sirt, fbp"),
        ("protocols.sirt_150.group", 2, "same group number"),
        ("protocols.new", {"projections": 3}, "protocols.new: 'algorithm' is a required property"),
        ("protocols.a/b", {"algorithm": "sirt", "projections": 3}, "protocols"),
        ("engine", "gpu", "engine is 'gpu'; use one of auto, cpu, astra_cuda"),
        ("noise.levels.dose10.A", 0, "noise.levels.dose10.A"),
        ("3", {}, "unknown key '3' in config"),
        ("noise.levels.dose10.A", "1e-4", "noise.levels.dose10.A: '1e-4' is text to YAML; write 1.0e-4"),
        ("noise.levels.dose10.A", "2.5E-03", "write 2.5e-3"),
        ("scan.pitch", " 0.5 ", "scan.pitch: ' 0.5 ' is text to YAML; write 0.5"),
        ("scan.turns", "1e1", "scan.turns: '1e1' is text to YAML; write 1.0e+1"),
        ("protocols.sirt_150.projections", "1e2", "projections: '1e2' is text to YAML; write 100"),
        ("protocols.sirt_150.projections", 150.0, "projections: 150.0 is not a whole number to YAML; write 150"),
        ("noise.levels.dose10.A", "nan", "'nan' is not of type 'number'"),
        ("protocols.sirt_150.algorithm", None, "protocols.sirt_150: 'algorithm' is a required property"),
        ("protocols.a-b", {}, "protocols: 'a-b' must be of letters, digits and underscores only"),
        ("protocols.ends\n", {}, "protocols: 'ends\\n' must be of letters, digits and underscores only"),
        ("noise.levels.dose10.repeats", 2, "noise.levels.dose10.repeats is 2; the noise calibration needs at least 3"),
        (
            "analyses.stability.noise",
            "dose1",
            "analyses.stability.noise names 'dose1', which does not exist; did you mean",
        ),
        ("analyses.pca.sirt.protocols", ["sirt_15"], "names 'sirt_15', which does not exist; did you mean 'sirt_150'"),
        ("noise.levels.dose10.repeats", 1, "dose10.repeats is 1; analyses.stability needs at least 2"),
        ("noise.levels.extra", {"repeats": 3}, "noise.levels.extra: give either photons, A or meets"),
        ("noise.levels.extra", {"repeats": 3, "A": 1e-5, "meets": MEETS}, "give either photons, A or meets"),
        ("noise.levels.extra", {"repeats": 3, "A": 1e-5, "photons": 1e5}, "give either photons, A or meets"),
        ("noise.levels.extra", {"repeats": 3, "photons": 1e5}, "extra.photons needs noise.model: physical; give A"),
        ("protocols.fbp_150.noise_kernel", NOISE_KERNEL, "fbp_150.noise_kernel needs kernel; add it or remove"),
        ("protocols.sirt_150.noise_kernel", NOISE_KERNEL, "sirt_150.noise_kernel is for algorithm fbp"),
        (
            "protocols.fbp_150.noise_kernel",
            NOISE_KERNEL | {"mtf10_per_cm": 1.5},
            "noise_kernel: mtf50_per_cm is 2, mtf10_per_cm is 1.5; the first must be less than the second",
        ),
        ("noise.levels.extra", {"repeats": 3, "meets": MEETS}, "meets.recording names 'scanner', which does not exist"),
        ("analyses.comparison", {"x": COMPARISON}, "analyses.comparison.x.recording names 'scanner'"),
        ("analyses.comparison", {"x": COMPARISON | {"where": {"dose": [1]}}}, "comparison.x.where.dose: [1] is not of"),
        ("analyses.stability.recordings", ["scanner"], "analyses.stability.recordings names 'scanner'"),
        (
            "analyses.noise_calibration.noise",
            ["dose10", "same"],
            "analyses.noise_calibration.noise names levels with the same A",
        ),
        (
            "analyses.optimal.sirt",
            "fbp_450",
            "analyses.optimal.sirt names 'fbp_450', whose algorithm is fbp; name a protocol of algorithm sirt",
        ),
        ("analyses.optimal.fbp", "sirt_450", "names 'sirt_450', whose algorithm is sirt"),
        ("analyses.pca.sirt.protocols", ["sirt_150", "fbp_150"], "analyses.pca.sirt.protocols names 'fbp_150', whose"),
        ("analyses.pca.fbp.protocols", ["sirt_150"], "analyses.pca.fbp.protocols names 'sirt_150', whose"),
        ("protocols.sirt_150.scan", "narrow", "protocols.sirt_150.scan names 'narrow'"),
        ("grid.shape", [48, 128], "grid.shape"),
        ("grid.spacing_mm", [1, 1, 0], "grid.spacing_mm.2"),
        ("scan.source_to_detector_mm", 400, "scan.source_to_detector_mm must be larger"),
        ("reconstruction.sirt.terms", 80, "80 is greater than the maximum of 75"),
        ("phantom.source", "ct", "phantom.source is ct, but phantom.ct is missing"),
    ],
)
def test_mistakes_are_one_line(path, value, message):
    config = changed(path, value)
    config["noise"]["levels"]["same"] = {"A": DEFAULT["noise"]["levels"]["dose10"]["A"], "repeats": 8}
    refuse(config, message)


def test_phantom_of_shapes_needs_its_object_and_no_overlay():
    config = changed("phantom", {"source": "object", "object": {"kind": "pmma_disc"}})
    refuse(config, "config: measured.overlay needs the ROIs of the printed phantom")
    config = changed("phantom", {"source": "object"}) | {"measured": {"overlay": False}}
    refuse(config, "phantom.source is object, but phantom.object is missing")


@pytest.mark.parametrize(
    "value, message",
    [
        (
            {"mask": "a.nii.gz"},
            "x.object needs kind (an object of shapes), mask and material, or labels and materials",
        ),
        ({"labels": "a.nii.gz"}, "x.object needs kind (an object of shapes), mask and material, or labels and"),
        ({"kind": "ball", "mask": "a.nii.gz"}, "x.object has both mask and kind"),
        ({"labels": "a.nii.gz", "materials": {1: "pmma"}, "material": "pmma"}, "x.object has both material and labels"),
        ({"kind": "ball", "unknown": True}, "x.object has both kind and unknown"),
        ({"kinds": "ball"}, "did you mean 'kind'?"),
    ],
)
def test_object_is_shapes_or_a_mask_or_a_label_map(value, message):
    settings = changed("diagnosis.recordings", {"x": {"object": value}}) | {"recordings": {"x": "x"}}
    refuse(settings, message)


def labelled(materials):
    return changed("diagnosis.recordings", {"x": {"object": {"labels": "a.nii.gz", "materials": materials}}}) | {
        "recordings": {"x": "x"}
    }


def test_photons_are_the_inverse_of_a():
    config = changed("noise.levels.extra", {"photons": 2.5e4, "repeats": 3})
    config["noise"]["model"] = "physical"
    assert read_study(config).noise.levels["extra"].A == pytest.approx(4e-5)


def test_labels_are_integers_or_equivalent_text():
    acrylic = {"compound": "C5H8O2", "density_g_per_cm3": 1.19}
    settings = labelled({0: "water", "1": "pmma", 20: acrylic})
    before = copy.deepcopy(settings)
    found = complete(settings)["diagnosis"]["recordings"]["x"]["object"]["materials"]
    assert found == {"0": "water", "1": "pmma", "20": acrylic}
    assert settings == before


@pytest.mark.parametrize(
    "materials, message",
    [
        ({}, "x.object.materials: {} should be non-empty"),
        ({-1: "pmma"}, "'-1' must be of digits alone: a label of the map, 0 or more"),
        ({"liver": "pmma"}, "'liver' must be of digits alone"),
        ({"01": "pmma"}, "'01' must be of digits alone"),
        ({True: "pmma"}, "the key True in diagnosis.recordings.x.object.materials is not text to YAML"),
        ({1.5: "pmma"}, "the key 1.5 in diagnosis.recordings.x.object.materials is not text to YAML"),
        ({1: 3}, "x.object.materials.1: is the number 3 to YAML; write it in quotes if it is a name"),
        ({1: {"compound": "H2O"}}, "x.object.materials.1: 'density_g_per_cm3' is a required property"),
        ({1: {"compound": "H2O", "density_g_per_cm3": 0}}, "density_g_per_cm3: 0 is less than or equal to"),
        ({1: {"compound": "H2O", "density": 1}}, "unknown key 'density' in diagnosis.recordings.x.object.materials.1"),
    ],
)
def test_invalid_labels_and_definitions_are_rejected(materials, message):
    refuse(labelled(materials), message)


@pytest.mark.parametrize("key", [1, 2.5, True, None])
@pytest.mark.parametrize("section", ["", "protocols", "noise.levels", "scans", "protocols.sirt_150", "analyses.pca"])
def test_keys_other_than_text_are_rejected(section, key):
    config = changed("scans.short", {"rows": 8})
    place = config
    for name in filter(None, section.split(".")):
        place = place[name]
    place[key] = {"algorithm": "sirt", "projections": 3}
    refuse(config, f"config: the key {key} in {section or 'config'} is not text to YAML")


def test_key_other_than_text_is_found_in_a_list():
    config = changed("phantom.ct", {"image": "a", "rois": [{"name": "a", "tissue_class": "b", 1: 2}]})
    refuse(config, "the key 1 in phantom.ct.rois.0 is not text")


@pytest.mark.parametrize(
    "text, value", [("1e-4", 1e-4), ("2.5e3", 2.5e3), ("-3E+02", -300), (".5e-6", 5e-7), ("5.e2", 500), ("7", 7)]
)
def test_numbers_are_suggested_in_yaml_notation(text, value):
    for path in ("scan.start_angle_deg", "scan.column_offset_px"):
        with pytest.raises(InputError) as error:
            complete(changed(path, text))
        assert yaml.safe_load(str(error.value).rsplit("write ", 1)[1]) == value


def test_calibration_uses_levels_of_one_a_only():
    config = changed("analyses.noise_calibration.noise", ["dose10", "same", "half"])
    config["noise"]["levels"]["same"] = {"A": DEFAULT["noise"]["levels"]["dose10"]["A"], "repeats": 8}
    complete(config)


def test_multicentre_takes_any_algorithm():
    complete(changed("analyses.pca.multicentre.protocols", ["sirt_150", "fbp_150"]))


def ct_of(*names, **more):
    rois = [{"name": name, "tissue_class": "liver", **more} for name in names]
    return {"source": "ct", "ct": {"image": "ct.nii.gz", "labels": "labels.nii.gz", "rois": rois}}


def test_measured_overlay_needs_the_rois_of_the_printed_phantom():
    refuse(changed("phantom", ct_of("liver")), "phantom.ct.rois also has liver; set measured.overlay: false")
    refuse(changed("phantom", ct_of(*list(TISSUE_CLASSES)[:5])), "phantom.ct.rois lacks metastasis; set measured")
    refuse(changed("phantom", ct_of(*TISSUE_CLASSES, "liver")), "phantom.ct.rois also has liver; set measured")
    complete(changed("phantom", ct_of("liver")) | {"measured": {"overlay": False}})
    complete(changed("phantom", ct_of(*TISSUE_CLASSES)))
    in_parts = ct_of("normal", "cyst", parts=2)
    in_parts["ct"]["rois"] += ct_of("hemangioma", "metastasis")["ct"]["rois"]
    complete(changed("phantom", in_parts))


@pytest.mark.parametrize("fit_on", ["measured", "pooled"])
def test_components_cannot_be_fitted_on_missing_measured_data(fit_on):
    config = changed("analyses.pca.fbp.fit_on", fit_on)
    complete(config)
    refuse(config | {"measured": {"overlay": False}}, f"analyses.pca.fbp.fit_on is {fit_on}, but measured.overlay")


def test_background_is_no_label():
    config = changed("phantom", ct_of("liver", label=0)) | {"measured": {"overlay": False}}
    refuse(config, "phantom.ct.rois.0.label: 0 is less than the minimum of 1")


def test_reading_a_configuration_loads_no_heavy_library():
    """Every job of the workflow reads it."""
    heavy = {"pandas", "scipy", "sklearn", "radiomics"}
    code = f"import sys, virtual_phantom.config.config; print({heavy} & set(sys.modules))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "workflow" / "lib")}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"


def test_null_removes_an_entry():
    config = complete(
        changed("protocols.sirt_450", None) | {"analyses": {"stability": {"noise": "dose10"}, "pca": None}}
    )
    assert "sirt_450" not in config["protocols"]
    assert "pca" not in config["analyses"]


def test_null_removes_a_key_of_a_protocol():
    config = changed("protocols.sirt_150.group", None)
    config["protocols"]["sirt_200"]["scan"] = None
    completed = complete(config)
    assert completed["protocols"]["sirt_150"] == {"algorithm": "sirt", "projections": 150}
    assert "scan" not in completed["protocols"]["sirt_200"]
    assert "sirt_150" not in Plan(read_study(config)).groups()


def test_named_scan_replaces_keys_of_the_default_scan():
    config = changed("scans.short", {"rows": 8, "trajectory": "circular"})
    config["protocols"]["sirt_150"]["scan"] = "short"
    plan = Plan(read_study(config))
    assert plan.geometry_of("sirt_150") == "short_views150"
    settings = plan.geometry_settings("short_views150")
    assert (settings.scan.rows, settings.scan.columns, settings.projections) == (8, 160, 150)
    geometry = scan_geometry(settings.scan, 150, grid_of(plan.study.grid))
    assert geometry.feed_per_rotation_mm == 0 and geometry.rows == 8
    assert plan.scan_of("fbp_150").rows == 48


def test_plan_of_the_paper():
    """8 groups x 10 seeds at one noise level; SIRT and FBP share their geometry."""
    plan = Plan(read_study(DEFAULT))
    assert plan.groups() == {
        f"{a}_{n}": g
        for g, (a, n) in enumerate([(a, n) for a in ("sirt", "fbp") for n in (150, 200, 250, 300)], start=1)
    }
    assert plan.geometry_of("sirt_150") == plan.geometry_of("fbp_150") == "views150"
    all_acquisitions = plan.acquisitions()
    assert all((protocol, "dose10") in all_acquisitions for protocol in plan.groups())
    assert ("sirt_300", "quadruple") in all_acquisitions and (
        "sirt_300",
        "quadruple",
    ) not in plan.acquisitions_with_features()


def images_of(jobs):
    return [(protocol, noise, seed) for bundle, protocols in jobs for protocol in protocols for noise, seed in bundle]


@pytest.mark.parametrize("seeds_per_job", [1, 4, 16])
@pytest.mark.parametrize("together", [(), ("fbp_150", "fbp_200", "second")])
def test_every_image_and_every_table_is_in_one_job(seeds_per_job, together):
    """Protocols with a common job and the same scan share their jobs."""
    config = changed("seeds_per_job", seeds_per_job)
    config["protocols"]["second"] = {**config["protocols"]["fbp_150"], "group": 9}
    for name in together:
        config["protocols"][name]["job"] = "one"
    plan = Plan(read_study(config))
    for wanted in (plan.acquisitions(), plan.acquisitions_with_features()):
        jobs = plan.jobs(wanted)
        expected = [(protocol, noise, seed) for protocol, noise in wanted for seed in plan.seeds(noise)]
        assert sorted(images_of(jobs)) == sorted(expected)
        assert all(len(bundle) <= seeds_per_job for bundle, _ in jobs)
        shared = {tuple(protocols) for _, protocols in jobs if len(protocols) > 1}
        assert shared == ({("fbp_150", "second")} if together else set())


def test_new_protocol_as_documented_leaves_the_jobs_of_the_default_study_unchanged():
    page = (ROOT / "docs" / "how-to" / "protocols.md").read_text(encoding="utf-8")
    (block,) = [part for part in page.split("```yaml\n")[1:] if "thick_slices" in part.partition("```")[0]]
    study = yaml.safe_load((ROOT / "config" / "config.yaml").read_text(encoding="utf-8"))
    before = Plan(read_study(study))
    assert len(before.jobs()) == 20
    study["protocols"] |= yaml.safe_load(block.partition("```")[0])["protocols"]
    after = Plan(read_study(study))
    new = [((("mgy10", f"{seed:02d}"),), ["thick_slices"]) for seed in range(10)]
    assert [job for job in after.jobs() if job not in before.jobs()] == new
    assert all(job in after.jobs() for job in before.jobs())
    assert after.own_scans() == before.own_scans() and after.shared_scans() == before.shared_scans()


def test_common_job_is_for_fbp():
    config = changed("protocols.sirt_150.job", "one")
    with pytest.raises(InputError, match="protocols.sirt_150.job is for algorithm fbp"):
        read_study(config)


def test_bundles_contain_every_acquisition_once_and_keep_levels_whole():
    plan = Plan(read_study(DEFAULT))
    seen = [
        (protocol, noise, seed)
        for bundle, protocols in plan.bundles().items()
        for protocol in protocols
        for noise, seed in bundle
    ]
    expected = [(protocol, noise, seed) for protocol, noise in plan.acquisitions() for seed in plan.seeds(noise)]
    assert sorted(seen) == sorted(expected)
    assert all(len(bundle) <= plan.study.seeds_per_job for bundle in plan.bundles())
    assert tuple([("dose10", seed) for seed in plan.seeds("dose10")]) in plan.bundles()


def test_level_matched_to_images_is_in_no_bundle_with_them():
    """Its images would otherwise wait for themselves."""
    config = complete(DEFAULT)
    config["noise"]["levels"] = {"one": {"A": 1e-6, "repeats": 3}, "met": {"meets": MEETS, "repeats": 3}}
    config["noise"]["levels"] |= {"other": {"A": 2e-6, "repeats": 3}, "next": {"A": 3e-6, "repeats": 3}}
    config["analyses"] = {"noise_calibration": {"protocols": ["sirt_300"], "noise": ["one", "other"]}}
    config["analyses"]["pca"] = {"sirt": {"protocols": ["sirt_300"], "noise": ["met", "next"]}}
    bundles = Plan(from_mapping(Study, config)).bundles()
    assert [sorted({noise for noise, _ in bundle}) for bundle in bundles] == [["one"], ["met"], ["next", "other"]]


def test_bundles_do_not_change_if_an_analysis_needs_more():
    """A further level for one protocol leaves every bundle that does not share its group unchanged."""
    before = Plan(read_study(DEFAULT)).bundles()
    more = changed("analyses.pca.multicentre.noise", ["dose10", "dose10_plus6", "dose10_plus16", "quadruple"])
    after = Plan(read_study(more)).bundles()
    gone = {(bundle, protocol) for bundle in before for protocol in before[bundle]} - {
        (bundle, protocol) for bundle in after for protocol in after[bundle]
    }
    assert not gone


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"disc": {"diameter_mm": 70, "material": "pmma"}, "object": {"mask": "m.nii.gz", "material": "pmma"}},
            "diagnosis.recordings.b has both disc and object; keep the one that was scanned",
        ),
        ({"physics_from": "c"}, "diagnosis.recordings.b.physics_from is 'c'; name another diagnosed recording: a"),
        ({"physics_from": "b"}, "diagnosis.recordings.b.physics_from is 'b'; name another diagnosed recording: a"),
        ({"physics_from": "a", "effects": ["scatter"]}, "has both effects and physics_from"),
        ({"baseline_from": "c"}, "diagnosis.recordings.b.baseline_from is 'c'; name another diagnosed recording: a"),
        ({"baseline_from": "b"}, "diagnosis.recordings.b.baseline_from is 'b'; name another diagnosed recording: a"),
        (
            {"object": {"unknown": True}, "effects": ["scatter"]},
            "diagnosis.recordings.b has an unknown object, so that effects has no meaning; remove one of them",
        ),
        ({"baseline_from": "a", "physics_from": "a"}, "b has both physics_from and baseline_from; keep one of them"),
    ],
)
def test_diagnosed_objects_and_their_physics_are_unique(settings, message):
    config = changed("recordings", {"a": "recordings/a", "b": "recordings/b"})
    refuse({**config, "diagnosis": {"recordings": {"a": {}, "b": settings}}}, message)


def test_materials_have_one_name_in_any_notation():
    config = changed("recordings", {"a": "recordings/a", "b": "recordings/b"})
    config["materials"] = {"soft": "Water", "dense": "Aluminum"}
    config["diagnosis"] = {
        "recordings": {
            "a": {"disc": {"diameter_mm": 70, "material": "PMMA"}},
            "b": {"object": {"mask": "b.nii.gz", "material": "acrylic"}},
        }
    }
    whole = complete(config)
    assert (whole["materials"]["soft"], whole["materials"]["dense"]) == ("water", "aluminium")
    recordings = whole["diagnosis"]["recordings"]
    assert recordings["a"]["disc"]["material"] == recordings["b"]["object"]["material"] == "pmma"
    # Every material key of the schema is one of these four.
    schema = (LIBRARY / "schemas" / "config.schema.yaml").read_text()
    assert schema.count('$defs/material"') == 4
    config["diagnosis"]["recordings"]["a"]["disc"]["material"] = "acryl"
    refuse(config, "config: diagnosis.recordings.a.disc.material is 'acryl'; use one of water, soft_tissue")
    config["diagnosis"]["recordings"]["a"] = {"disc": "PMMA"}
    refuse(config, "config: diagnosis.recordings.a.disc: 'PMMA' is not of type 'object'")


def test_circular_transfer_of_physics_is_rejected():
    config = changed("recordings", {name: f"recordings/{name}" for name in "abc"})
    diagnosed = {"a": {}, "b": {"physics_from": "a"}, "c": {"physics_from": "b"}}
    refuse({**config, "diagnosis": {"recordings": diagnosed}}, "which has physics_from; name the recording given there")
    diagnosed["c"] = {"physics_from": "a"}
    complete({**config, "diagnosis": {"recordings": diagnosed}})
    diagnosed["c"] = {"baseline_from": "b"}
    refuse(
        {**config, "diagnosis": {"recordings": diagnosed}}, "b', which has physics_from; name the recording given there"
    )
    diagnosed["c"] = {"baseline_from": "a"}
    complete({**config, "diagnosis": {"recordings": diagnosed}})
    scanners = {"s": {"recordings": ["a", "c"]}}
    together = {"recordings": diagnosed, "scanners": scanners}
    refuse({**config, "diagnosis": together}, "names 'c', which has baseline_from: a; remove that key")


def test_protocols_of_a_scanner_partition_its_recordings():
    config = changed("recordings", {name: f"recordings/{name}" for name in "abc"})
    scanner = {"recordings": ["a", "b"], "protocols": {"low": ["a"], "high": ["b"]}}
    config["diagnosis"] = {"recordings": {name: {} for name in "abc"}, "scanners": {"s": scanner}}
    complete(config)
    scanner["protocols"]["high"] = ["a", "b"]
    refuse(config, "diagnosis.scanners.s.protocols: 'a' is in low and in high; keep one of them")
    scanner["protocols"]["high"] = ["c"]
    refuse(config, "diagnosis.scanners.s.protocols.high names 'c', which does not exist; known: a, b")


def test_test_recordings_of_a_scanner_are_its_own_and_leave_two_for_selection():
    config = changed("recordings", {name: f"recordings/{name}" for name in "abcd"})
    scanner = {"recordings": ["a", "b", "c"], "test_recordings": ["c"]}
    config["diagnosis"] = {"recordings": {name: {} for name in "abcd"}, "scanners": {"s": scanner}}
    complete(config)
    scanner["test_recordings"] = ["d"]
    refuse(config, "diagnosis.scanners.s.test_recordings names 'd', which does not exist; known: a, b, c")
    scanner["test_recordings"] = ["b", "c"]
    refuse(
        config,
        "diagnosis.scanners.s.test_recordings leaves fewer than two recordings for the selection of effects; "
        "remove some",
    )


def test_image_effects_are_rejected_for_images_in_boxes():
    voxels = {"spacing_mm": [1.0, 0.7, 0.7], "thickness_mm": 2.0}
    config = changed("protocols.boxed", {"algorithm": "fbp", "projections": 200, "voxels": voxels})
    config["noise"]["model"] = "physical"
    config["physics"] = {"hu_calibration": None}
    refuse(config, "protocols.boxed.voxels: its images are boxes around ROIs, and hu_calibration acts on whole images")
    config["protocols"]["boxed"]["physics"] = {"scatter": None}
    complete(config)
