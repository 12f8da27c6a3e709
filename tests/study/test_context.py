"""Context of the rules: what they know of a configured study, without Snakemake or computation."""

import copy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from simulated_scans import SCAN

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.settings import to_mapping
from virtual_phantom.io import volumes
from virtual_phantom.report import study
from virtual_phantom.study.context import or_exit, read_context

ROOT = Path(__file__).resolve().parents[2]
DEFAULT = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text()) | {
    "engine": "cpu",
    "results_dir": "results",
}
MEETS = {"recording": "scanner", "where": {"dose_mgy": 1}, "rois": ["cyst_1"], "protocol": "sirt_300"}


def recorded(folder, name, kind, **more):
    """A recording of which only the paths exist."""
    place = folder / name
    place.mkdir()
    (place / "repeat").write_bytes(bytes(3_000_000))
    content = {"name": name, "kind": kind, "repeats": ["repeat"], **more}
    (place / "recording.yaml").write_text(yaml.safe_dump(content))
    return str(place)


def context_of(**changes):
    config = copy.deepcopy(DEFAULT)
    for key, value in changes.items():
        config[key] = {**config[key], **value} if isinstance(value, dict) and key in config else value
    return read_context(config, ROOT / "workflow")


def test_registrations_state_the_settings_that_decide_verdicts():
    changes = {"matters": None, "model_accuracy": {"default": 0.5}}
    usual, changed = (context_of(diagnosis=one).benchmark.registered for one in ({}, changes))
    assert usual["seed"] == changed["seed"] and "recordings" not in usual
    assert usual["matters"] and changed["matters"] is None
    assert usual["model_accuracy"]["default"] < changed["model_accuracy"]["default"] == 0.5


@pytest.fixture
def with_recordings(tmp_path):
    """The paper's groups with recordings and a noise level that is matched to one of them."""
    recordings = {"scanner": recorded(tmp_path, "scanner", "features"), "ct": recorded(tmp_path, "ct", "images")}
    levels = DEFAULT["noise"]["levels"] | {"met": {"repeats": 3, "meets": MEETS}}
    compared = {"recording": "scanner", "where": {"dose_mgy": 1, "kernel": "soft"}, "protocol": "fbp_150"}
    asked = {"comparison": {"near": compared | {"noise": "dose10"}, "met": compared | {"noise": "met"}}}
    return context_of(recordings=recordings, noise={"levels": levels}, analyses=asked)


def test_all_outputs_of_a_configuration():
    targets = context_of(keep_projections=True, results_dir="r/").targets()
    assert len(targets) == len(set(targets)) and all(path.startswith("r/") for path in targets)
    assert targets[-1] == "r/index.html"
    assert {"r/figures/rois.png", "r/figures/pca_fbp.pdf", "r/tables/stability.csv", "r/features.parquet"} <= {*targets}
    assert "r/projections/views150/dose10/seed09.h5" in targets
    assert not [path for path in context_of().targets() if "projections" in path]


def test_protocols_with_the_same_acquisitions_share_noise():
    context = context_of()
    groups, sharing = context.plan.groups(), context.selections.sharing()
    assert sharing[groups["sirt_150"]] == sharing[groups["fbp_150"]] != sharing[groups["sirt_200"]]
    assert len(sharing) == 8
    assert set(context_of(noise={"draws": "common"}).selections.sharing().values()) == {"common"}


def test_next_commands_name_the_configuration_of_the_study():
    base = "config/paper_groups.yaml"  # Snakemake adds it last
    files = [str(Path("config/tiny.yaml").absolute()), "my.yaml", base]
    assert context_of(trial=True).pages.commands()["The default study, for real results"] == "snakemake --cores 2"
    larger = "virtual-phantom init ct --labels labels.nii.gz --size normal --out my-normal.yaml"
    assert list(context_of(trial=larger).pages.commands().values())[0] == larger
    pages = context_of().pages
    assert list(pages.commands().values())[-1] == "snakemake --cores 2"
    commands = list(replace(pages, configured_by=tuple(files)).commands().values())
    assert commands[-1] == "snakemake --cores 2 --configfile config/tiny.yaml my.yaml"
    assert commands[-2] == "snakemake plan --cores 2 --configfile config/tiny.yaml my.yaml"
    for alone, settings in (("config/config.yaml",), ""), ((str(Path(base).absolute()), base), f" --configfile {base}"):
        assert list(replace(pages, configured_by=alone).commands().values())[-1] == f"snakemake --cores 2{settings}"
    assert not [command for command in commands if "diagnosis" in command or "recordings" in command]


def test_memory_is_that_of_the_arrays():
    """Four bytes per number, 30 % more, and 600 MB for Python."""
    context = context_of(grid={"shape": [10, 100, 200], "oversampling": 3})
    assert context.megabytes() == 600
    assert context.megabytes(volumes=50, volume_lanes=20) == 600 + int(1.3 * 50 * 20 * 10 * 100 * 200 * 4 / 1e6)
    assert context.megabytes(fine=9) == 600 + int(1.3 * 9 * 27 * 200_000 * 4 / 1e6)
    scan = context.study.scan
    pixels = 150 * scan.rows * scan.columns
    assert context.megabytes(projections=8, geometry="views150") == int(600 + 1.3 * 8 * pixels * 4 / 1e6)


def test_matched_level_is_an_input(with_recordings):
    one, found = (
        with_recordings.acquisitions.acquisition("dose10", "03"),
        with_recordings.acquisitions.acquisition("met", "03"),
    )
    assert one == {"noise": "dose10", "noise_level": DEFAULT["noise"]["levels"]["dose10"]["A"], "seed": 3}
    assert found["noise_level"] is None
    assert with_recordings.acquisitions.level_files(["dose10", "met", "met"]) == ["results/noise/met.json"]
    groups = {noise: with_recordings.acquisitions.group(((noise, "00"),)) for noise in ("dose10", "met")}
    assert groups == {"dose10": "acquisitions", "met": "matched_acquisitions"}
    assert with_recordings.comparisons.noise_target_features("met") == "results/recordings/scanner/features.csv"


def test_recordings_request_memory_for_their_largest_file(with_recordings):
    assert (
        with_recordings.recordings.megabytes("scanner") == 1036
        and with_recordings.recordings.image_megabytes("ct") == 120
    )
    inputs = with_recordings.recordings.inputs("ct")
    assert inputs["rois"] == "results/recordings/ct/rois.csv" and len(inputs["files"]) == 2
    assert set(with_recordings.recordings.inputs("scanner")) == {"files"}
    assert with_recordings.recordings.pictures() == [
        "results/figures/recording_ct.png",
        "results/figures/recording_ct.pdf",
    ]


def test_header_of_a_comparison_states_what_is_compared(with_recordings):
    title = "FBP 150, noise dose10, against scanner (dose mGy 1, kernel soft)"
    assert with_recordings.comparisons.title("near") == title
    shown = {figure["title"]: figure for figure in with_recordings.pages.figures()}
    assert shown[title]["section"] == "Recordings" and shown[title]["wildcards"] == {"comparison": "near"}


def test_report_has_figures_with_captions_and_tables_with_titles_first():
    pages = context_of().pages
    assert len(pages.pictures()) == len(pages.caption_files()) == len(pages.figures())
    assert all(Path(path).exists() for path in pages.caption_files())
    titles = dict(zip(pages.table_titles(), pages.tables(), strict=True))
    assert list(titles)[:3] == ["Which features to trust", "Stable features by measure", "Measures of stability"]
    assert list(titles)[-2:] == ["Separability of classes: FBP", "Separability of classes: multicentre"]
    assert titles["All features"] == "results/features.csv"
    assert pages.diagnoses() == {} and pages.links() == {"Viewer of slices": "viewer.html"}


def test_existing_diagnoses_are_in_the_report(tmp_path):
    recordings = {"bench": recorded(tmp_path, "bench", "features")}
    compared = {"recording": "bench", "where": {}, "protocol": "fbp_150", "noise": "dose10"}
    context = context_of(
        results_dir=f"{tmp_path}/r",
        recordings=recordings,
        analyses={"comparison": {"one": compared, "two": compared}},
        diagnosis={"comparisons": ["one", "two"]},
    )
    assert context.pages.diagnoses() == {}
    page = tmp_path / "r" / "diagnosis" / "two" / "report.html"
    page.parent.mkdir(parents=True)
    page.touch()
    assert list(context.pages.diagnoses()) == [str(page)]


def test_exported_images_are_those_of_the_figure_of_scans_or_named_ones():
    optimal = DEFAULT["analyses"]["optimal"]
    assert context_of().pages.exported == [(optimal[name], optimal["noise"], "00") for name in ("fbp", "sirt")]
    named = context_of(dicom={"images": ["fbp_150/dose10/seed03"]}).pages
    folder = "results/dicom/fbp_150/dose10/seed03"
    assert named.exported_files() == [f"{folder}/series", f"{folder}/rois.dcm"]
    assert named.series("fbp_150", "dose10", "03")["label"] == "fbp_150 dose10 seed 03 (simulated)"
    with pytest.raises(InputError, match="dicom.images names fbp_150/dose10/seed99, which the study does not make"):
        context_of(dicom={"images": ["fbp_150/dose10/seed99"]})


def test_case_is_modeled_by_its_own_protocol():
    proof = context_of().proof
    case, last = proof.cases[0], proof.cases[-1]  # projections and images
    model, held_out = proof.model(case), proof.held_out_model(case)
    assert model.folder == f"results/proof/recordings/{case}" and model.protocol is None
    assert held_out.folder == f"results/proof/held_out_protocol/{case}"
    settings = proof.settings
    assert held_out.settings.nominal_photons == settings.held_out_protocol.photons
    times = settings.images.views_times
    assert proof.model(last).protocol.projections == settings.scan.views * times
    assert "images" in proof.scan_settings(last) and "images" not in proof.scan_settings(case)
    assert set(proof.tried_on(last)) == set(settings.images.tried)


def test_tried_effects_of_the_blind_test_are_those_of_the_configuration():
    proof = context_of().proof
    assert all(len(proof.tried_on(case)) > 25 for case, world in proof.worlds.items() if world.kind == "projections")
    proof = context_of(proof={"effects": ["scatter"], "tried": ["motion", "scatter"], "pairs": 0}).proof
    tried = [proof.tried_on(case) for case, world in proof.worlds.items() if world.kind == "projections"]
    assert all(set(names) <= {"scatter", "motion"} for names in tried) and {"scatter", "motion"} in map(set, tried)
    with pytest.raises(InputError, match="proof.tried: there is no effect 'glow'"):
        context_of(proof={"effects": ["scatter"], "tried": ["scatter", "glow"], "pairs": 0})
    images = to_mapping(context_of().proof.settings.images)
    with pytest.raises(InputError, match="proof.images.tried: there is no effect 'glow'"):
        context_of(proof={"images": images | {"tried": [*images["tried"], "glow"]}})


def test_expected_seconds_of_the_study_files():
    expected = context_of().expected_seconds()
    assert all(seconds > 0 for seconds in expected.values())
    assert "results/projections/views150/clean.h5" in expected and "results/features.csv" in expected
    assert expected["results/tables/trust.csv"] > 5  # intervals of every region, not the start-up time alone


def test_files_of_a_diagnosed_object_are_inputs_of_its_jobs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("disc", "rods", "holes"):
        array = np.ones((1, 4, 4), np.uint8)
        volumes.write_nifti(volumes.Volume(array, Grid(array.shape, (1.0, 1.0, 1.0))), f"{name}.nii.gz")
    objects = {
        "disc": {"mask": "disc.nii.gz", "material": "pmma"},
        "rods": {"labels": "rods.nii.gz", "materials": {1: "pmma", 5: "aluminium"}},
        "holes": {"labels": "holes.nii.gz", "materials": {1: "pmma"}},
        "whole": {"kind": "pmma_disc"},
    }
    context = context_of(
        recordings={name: recorded(tmp_path, name, "projections", scan=SCAN) for name in objects},
        diagnosis={
            "recordings": {name: {"object": one} for name, one in objects.items()},
            "scanners": {"bench": {"recordings": [*objects]}},
        },
    )
    inputs = context.diagnosis.inputs("rods")
    assert inputs["labels"] == "rods.nii.gz" and not {"mask", "shapes", "phantom"} & set(inputs)
    assert context.diagnosis.model("rods").settings.object.materials == {"1": "pmma", "5": "aluminium"}
    assert not context.diagnosis.regions("rods") and not context.diagnosis.same_material("rods")
    together = context.diagnosis.scanner_inputs("bench")
    assert together["masks"] == ["disc.nii.gz"] and together["label_maps"] == ["rods.nii.gz", "holes.nii.gz"]
    assert len(together["shapes"]) == 1 and "phantom" not in together


def test_recordings_of_a_scanner_declare_the_same_physics(tmp_path):
    """A declaration applies to all recordings; partial and different declarations are rejected."""

    def stated(amount, **more):
        return {"scatter": {"amount": {"value": amount, "sd": 0.01}, "width_mm": {"value": 60, "sd": 5}}} | more

    folders = {name: recorded(tmp_path, name, "projections", scan=SCAN) for name in ("one", "two", "three")}

    def bench(baselines=None, baseline=None, **scanner):
        one = {"disc": {"diameter_mm": 70, "material": "pmma"}}
        recordings = {
            name: one | ({"baseline": baselines[name]} if baselines and name in baselines else {}) for name in folders
        }
        scanner = {"recordings": ["one", "two"], "baseline": baseline or {}, **scanner}
        return context_of(
            recordings=folders, diagnosis={"recordings": recordings, "scanners": {"bench": scanner}}
        ).diagnosis

    found = bench(baseline=stated(0.1))
    assert "scatter" not in found.shared_candidates("bench") and "scatter" in found.candidates["one"]
    known = {name: one.settings.baseline for name, one in found.models("bench").items()}
    assert known == dict.fromkeys(("one", "two"), stated(0.1)) and "scatter" in found.in_fits("one")
    judged = bench(recordings=["one", "two", "three"], test_recordings=["three"])
    assert [*judged.models("bench")] == ["one", "two", "three"]
    assert [*judged.models("bench", judged=False)] == ["one", "two"]
    assert not found.settings["one"].baseline
    # Protocol parameters may differ.
    apart = bench({"one": stated(0.1), "two": stated(0.2)})
    assert apart.models("bench")["two"].settings.baseline["scatter"]["amount"]["value"] == 0.2
    spot = {"focal_spot": {"width_mm": {"value": 1, "sd": 0.1}, "length_mm": {"value": 1, "sd": 0.1}}}
    wider = {"focal_spot": {"width_mm": {"value": 2, "sd": 0.1}, "length_mm": {"value": 1, "sd": 0.1}}}
    for baselines, words in (
        ({"one": spot}, "bench: recording one declares focal_spot, but others do not; declare it under diagnosis"),
        ({"one": spot, "two": wider}, "bench: one and two declare different values of width_mm of focal_spot"),
    ):
        with pytest.raises(InputError, match=words):
            bench(baselines)
    with pytest.raises(InputError, match="bench.effects: scatter is declared under baseline; remove it"):
        bench(baseline=stated(0.1), effects=["scatter"])
    with pytest.raises(InputError, match="bench.baseline.scatter: nothing is stated of width_mm"):
        bench(baseline={"scatter": {"amount": {"value": 0.1, "sd": 0.01}}})


def test_large_scan_requests_memory_for_its_fitted_views(tmp_path):
    """A clinical turn needed 6.1 GB with two processes (docs/explanation/performance.md); all views need ten times as
    much.
    """
    scan = SCAN | {"views": 984, "views_per_rotation": 984, "rows": 64, "columns": 888}
    folder = recorded(tmp_path, "turn", "projections", scan=scan)

    def megabytes(processes, **settings):
        one = {"disc": {"diameter_mm": 300, "material": "water"}, "samples": 1, **settings}
        context = context_of(recordings={"turn": folder}, diagnosis={"recordings": {"turn": one}})
        return context.diagnosis.megabytes("turn", processes)

    assert 5000 < megabytes(2) < 7000 and megabytes(1) < megabytes(2)
    assert megabytes(2, view_step=1) > 50_000


def test_bad_input_ends_a_rule_function_with_one_line():
    @or_exit
    def asked(wildcards):
        raise InputError(f"config: {wildcards} is missing; add it")

    with pytest.raises(SystemExit, match="^Error: config: x is missing; add it$"):
        asked("x")


def test_context_loads_no_heavy_library():
    """Every start of Snakemake creates it, and most read the effects and the matched noise."""
    code = (
        "import sys, yaml; from pathlib import Path; from virtual_phantom.study.context import read_context; "
        "from virtual_phantom.physics import effect; "
        "context = read_context(yaml.safe_load(Path('config/paper_groups.yaml').read_text()), Path('workflow')); "
        "context.targets(), context.selections.measured_noise, [effect.load(name) for name in effect.names()]; "
        "heavy = {'pandas', 'sklearn', 'radiomics', 'snakemake', 'numba', 'nibabel', 'SimpleITK', 'matplotlib'}; "
        "heavy |= {f'scipy.{part}' for part in ('stats', 'special', 'linalg', 'ndimage', 'optimize')}; "
        "print(heavy & set(sys.modules))"
    )
    environment = {"PYTHONPATH": str(ROOT / "workflow" / "lib")}
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"


def captions_of(context, **config):
    """Captions of a study's figures with another configuration."""
    figures = study.report_figures(context.pages.pictures(), context.pages.caption_files(), context.pages.figures())
    return {one.path.stem: study.caption(one, to_mapping(context.study) | config) for one in figures}


def test_captions_mention_the_printed_phantom_only_where_it_is_shown():
    words = ("Flouris", "Cancer Imaging", "printed phantom", "Black", "Hollow", "paper")
    settings = {"phantom": {"source": "ct", "ct": {}}}
    for name, caption in captions_of(context_of(measured={"overlay": False}), **settings).items():
        assert not [word for word in words if word in caption], name
    shown = captions_of(context_of())
    assert [name for name, caption in shown.items() if "Flouris" not in caption] == ["trust_map"]  # no figure of theirs
    assert "Black horizontal lines" in shown["noise_calibration"]
    assert all("Hollow markers" in shown[name] for name in ("pca_sirt", "pca_fbp", "pca_multicentre"))
    assert "Figure 2 of" in shown["scans"] and "built-in phantom" in shown["rois"]


def test_captions_name_panels_like_the_figures(with_recordings):
    caption = captions_of(with_recordings)["comparison_near"]
    assert "a: difference of the means" in caption and "b: ratio" in caption and "Middle" not in caption
