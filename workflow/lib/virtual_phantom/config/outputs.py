"""Table of all files that the workflow makes, which targets, the plan, the report and the reference page read.

Rules state the same paths, so that their files show what they make; tests/workflow/test_outputs.py compares both. Logs
and benchmarks are not in the table: they lie in `logs` and are named after their jobs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

WILDCARD = re.compile(r"\{(\w+)\}")
PICTURES = (".png", ".pdf")  # formats of a figure
PCA = ("sirt", "fbp", "multicentre")  # possible entries of analyses.pca


@dataclass(frozen=True)
class Output:
    """One kind of file or folder.

    Attributes
    ----------
    name : str
        Name in the code.
    pattern : str
        Path relative to results_dir, with wildcards in braces.
    description : str
        Content of the file.
    title : str or None
        Title in a report; None: the name of the file.
    section : str or None
        Section of Snakemake's report, and of the study's report for a figure; None: not shown.
    caption : str or None
        Caption file in workflow/report, without suffix; None: the name of the described file.
    suffixes : tuple of str
        Suffixes of an output with several files.
    rule : str
        Rule that makes it, without the number that distinguishes rules of one kind.
    stage : str or None
        Name of the rates of the rule's jobs; the configuration may add to it (costs.jobs.Sizes). None: not planned.
    counted : str or None
        Kind of file whose rate gives the bytes that a job writes; None: not counted.
    """

    name: str
    pattern: str
    description: str
    title: str | None = None
    section: str | None = None
    caption: str | None = None
    suffixes: tuple[str, ...] = ("",)
    rule: str = ""
    stage: str | None = None
    counted: str | None = None

    def paths(self, **known: str) -> tuple[str, ...]:
        """Return the paths relative to results_dir. Unknown wildcards stay in braces."""
        return tuple(filled(self.pattern, **known) + suffix for suffix in self.suffixes)

    def caption_file(self, **known: str) -> str:
        """Return the name of the caption file in workflow/report."""
        return f"{self.caption or PurePosixPath(filled(self.pattern, **known)).stem}.rst"


def filled(pattern: str, **known: str) -> str:
    """Return a pattern with the known wildcards replaced."""
    return WILDCARD.sub(lambda match: str(known.get(match[1], match[0])), pattern)


# Kinds of files that jobs of a stage write, if these are not tables.
WRITTEN = {
    "phantom": "phantom",
    "project": "clean projections",
    "acquire": "noisy projections",
    "reconstruct": "images",
    "extract": "features",
    "merge_features": "features",
    "figures": "figures",
    "compile_kernels": None,
}


def _made_by(rule: str, *outputs: Output, stage: str | None = None, counted: str | None = "") -> tuple[Output, ...]:
    """Return the outputs of a rule. By default, the kind of file that is counted follows from the stage."""
    if counted == "":
        counted = WRITTEN.get(stage, "tables") if stage else None
    return tuple(replace(output, rule=rule, stage=stage, counted=counted) for output in outputs)


def _table(
    name: str, description: str, title: str, section: str | None = None, stage: str = "tables"
) -> tuple[Output, ...]:
    """Return the output of a table, whose rule and file have the same name."""
    return _made_by(name, Output(name, f"tables/{name}.csv", description, title, section), stage=stage)


def _figure(
    pattern: str,
    section: str,
    title: str,
    description: str,
    *,
    name: str = "",
    caption: str | None = None,
    stage: str | None = "figures",
) -> tuple[Output, ...]:
    """Return the output of a figure, whose rule has the same name."""
    name = f"figure_{name or pattern}"
    output = Output(name, f"figures/{pattern}", description, title, section, caption, PICTURES)
    return _made_by(name, output, stage=stage, counted=stage and "figures")


# Tables with a title are in the order of the study's report.
OUTPUTS = (
    *_made_by(
        "phantom",
        Output("phantom_image", "phantom/image.nii.gz", "the phantom in HU, on the grid of the images"),
        Output("phantom_fine", "phantom/fine.nii.gz", "the phantom on finer voxels, as it is scanned"),
        Output("phantom_table", "phantom/rois.csv", "the phantom's ROIs, one row each"),
        Output("phantom_rois", "phantom/rois", "masks of the ROIs"),
        stage="phantom",
    ),
    *_made_by(
        "rois_on_voxels",
        Output("voxel_table", "phantom/{voxels}/rois.csv", "the phantom's ROIs on a scanner's voxels, one row each"),
        Output("voxel_rois", "phantom/{voxels}/rois", "masks of these ROIs"),
        stage="phantom",
        counted="tables",
    ),
    *_made_by(
        "positions",
        Output("positions", "phantom/positions.csv", "position of the phantom in every repeat of every noise level"),
        stage="tables",
    ),
    *_made_by(
        "rois_moved",
        Output(
            "moved_table", "phantom/moved/seed{seed}/{voxels}/rois.csv", "ROIs of a re-positioned phantom, one row each"
        ),
        Output("moved_rois", "phantom/moved/seed{seed}/{voxels}/rois", "masks of these ROIs"),
        stage="phantom",
        counted="tables",
    ),
    *_made_by(
        "mean_scan",
        Output("mean_scan", "public_scans/mean.nii.gz", "the mean of public scans, HU, without the table"),
        Output("mean_regions", "public_scans/regions.nii.gz", "majority vote of the regions of these scans"),
        Output(
            "mean_table", "public_scans/scans.csv", "position of the object in each of these scans, and their noise"
        ),
        Output("mean_spectra", "public_scans/spectra.csv", "power of the mean and of its noise, by spatial frequency"),
    ),
    *_made_by(
        "without_own_blur",
        Output("sharp_scan", "public_scans/sharp.nii.gz", "the mean without the blur and noise of its scanner"),
        Output("own_blur", "public_scans/own_blur.csv", "resolution and SDs of regions before and after"),
    ),
    *_made_by(
        "scan_features",
        Output("scan_features", "public_scans/features/{scan}.csv", "features of one public scan, one row per ROI"),
        Output("scan_features_2d", "public_scans/features_2d/{scan}.csv", "features of the largest slice of each ROI"),
    ),
    *_made_by(
        "compared_features",
        Output("compared_features", "public_scans/compared/features.csv", "features of the compared public scans"),
        Output("compared_document", "public_scans/compared/recording.yaml", "these features as a recording"),
        Output("compared_features_2d", "public_scans/compared_2d/features.csv", "features of the largest slices"),
        Output("compared_document_2d", "public_scans/compared_2d/recording.yaml", "these features as a recording"),
    ),
    *_made_by(
        "compile_kernels",
        Output("kernels", "logs/kernels/{lanes}.txt", "marker: kernels for this number of realizations are compiled"),
        stage="compile_kernels",
    ),
    *_made_by(
        "project", Output("clean", "projections/{geometry}/clean.h5", "noise-free line integrals"), stage="project"
    ),
    *_made_by(
        "project_moved",
        Output(
            "moved_clean",
            "projections/{geometry}/clean_seed{seed}.h5",
            "noise-free line integrals of a re-positioned repeat",
        ),
        stage="project",
    ),
    *_made_by(
        "acquire",
        Output("acquisition", "projections/{geometry}/{noise}/seed{seed}.h5", "projections of one acquisition"),
        stage="acquire",
    ),
    *_made_by(
        "reconstruct",
        Output("image", "images/{protocol}/{noise}/seed{seed}.nii.gz", "the image of one acquisition, HU"),
        stage="reconstruct",
    ),
    *_made_by(
        "extract",
        Output(
            "image_features", "features/{protocol}/{noise}/seed{seed}.csv", "features of one image, one row per ROI"
        ),
        stage="extract",
    ),
    # Figures of the study
    *_figure("rois", "Phantom", "Regions of interest", "the ROIs on the phantom"),
    *_figure("scans", "Phantom", "Input, FBP and SIRT", "axial slices, and their differences from the input"),
    *_figure("noise_calibration", "Noise", "Noise calibration", "image variance against the noise level A"),
    *_figure(
        "stability_discrimination",
        "Stability",
        "Stability and discriminative power",
        "stability and discriminative power of each feature",
    ),
    *_figure(
        "overlap",
        "Stability",
        "Overlap with the measured phantom",
        "number of the best features that are also best in the measured phantom",
    ),
    *_figure("physics_change", "Stability", "With physics and without", "features whose stability the physics changes"),
    *_figure(
        "overlap_{recording}",
        "Recordings",
        "Overlap with {recording}",
        "number of the best features that are also best in a recording",
        name="overlap_recording",
        caption="overlap_recording",
        stage="recordings",
    ),
    *_figure(
        "pca_sirt",
        "Principal components",
        "Iterative reconstruction (SIRT)",
        "principal components of SIRT images and their ROIs",
    ),
    *_figure(
        "pca_fbp",
        "Principal components",
        "Filtered back-projection (FBP)",
        "principal components of FBP images and their ROIs",
    ),
    *_figure(
        "pca_multicentre",
        "Principal components",
        "Wider noise range (multi-center)",
        "principal components over more noise levels",
    ),
    *_figure(
        "comparison_{comparison}",
        "Recordings",
        "Comparison {comparison}",
        "every feature and ROI compared with a recording",
        name="comparison",
        caption="comparison",
        stage="recordings",
    ),
    # Tables of the study
    *_table(
        "trust",
        "which features to trust: stability with its interval, its basis, and a sentence",
        "Which features to trust",
        "Stability",
        stage="trust",
    ),
    *_table(
        "physics_change",
        "stability of every feature with and without the study's physics",
        "Stability with and without physics",
        "Stability",
        stage="trust",
    ),
    *_made_by(
        "stability_measures",
        Output(
            "stable_features",
            "tables/stable_features.csv",
            "stable features by measure",
            "Stable features by measure",
            "Stability",
            "stability_measures",
        ),
        Output(
            "stability_measures",
            "tables/stability_measures.csv",
            "ICC, CCC, coefficients of variation and W",
            "Measures of stability",
            "Stability",
        ),
        stage="tables",
    ),
    *_table("stability", "W for pairs of groups and pairs of ROIs", "Stability and discriminative power by W"),
    *_table("top_features", "the ten best features and those of the paper", "Ten best features", "Stability"),
    *_table(
        "overlap",
        "number of the best features that are also best in the measured phantom",
        "Overlap with the measured phantom",
    ),
    *_table(
        "noise_calibration", "image variance against the noise level A", "Noise calibration", stage="noise_calibration"
    ),
    *_table(
        "matched_noise",
        "agreement of matched noise levels with their recordings",
        "Matched noise levels",
        "Recordings",
        stage="recordings",
    ),
    *_made_by(
        "merge_features",
        Output("features", "features.csv", "features of all images, one row per image and ROI", "All features"),
        stage="merge_features",
    ),
    *_made_by(
        "pca",
        Output(
            "pca",
            "tables/pca_{pca}.csv",
            "principal components of a selection of protocols",
            "Principal components: {pca}",
        ),
        Output(
            "separability",
            "tables/separability_{pca}.csv",
            "discrimination of classes by principal components",
            "Separability of classes: {pca}",
        ),
        stage="tables",
    ),
    *_made_by(
        "parquet", Output("parquet", "{table}.parquet", "a table in Parquet format"), stage="parquet", counted="tables"
    ),
    # Recordings, and comparisons with them
    *_made_by(
        "download_htc2022",
        Output("sinogram", "downloads/htc2022_{disc}", "a sinogram of the Helsinki challenge as a recording"),
    ),
    *_made_by(
        "recording_summary",
        Output("summary", "recordings/{recording}/summary.json", "content of a recording and settings of its scan"),
    ),
    *_made_by("recordings", Output("recordings", "recordings/recordings.csv", "all recordings, one row each")),
    *_figure(
        "recording_{recording}",
        "Recordings",
        "Recording {recording}",
        "preview of a recording of projections or images",
        name="recording",
        caption="recording",
        stage=None,
    ),
    *_made_by(
        "align_recording",
        Output(
            "alignment", "recordings/{recording}/alignment.json", "position of the phantom in a recording of images"
        ),
        Output("recorded_image", "recordings/{recording}/image.nii.gz", "the mean of a recording's images"),
        Output("recorded_table", "recordings/{recording}/rois.csv", "the phantom's ROIs on the recording's grid"),
        Output("recorded_rois", "recordings/{recording}/rois", "masks of these ROIs"),
    ),
    *_figure(
        "alignment_{recording}",
        "Recordings",
        "Alignment of {recording}",
        "a recording with the phantom's outlines",
        name="alignment",
        caption="alignment",
        stage=None,
    ),
    *_made_by(
        "recording_features",
        Output("recorded_features", "recordings/{recording}/features.csv", "features of a recording"),
        stage="recordings",
    ),
    *_made_by(
        "recording_scores",
        Output(
            "scores",
            "recordings/{recording}/scores.csv",
            "stability and discriminative power of a recording's features",
        ),
        stage="recordings",
    ),
    *_made_by(
        "overlap_recording",
        Output("overlap_recording", "tables/overlap_{recording}.csv", "the overlap with a recording's best features"),
        stage="recordings",
    ),
    *_made_by(
        "stability_beside",
        Output(
            "stability_beside",
            "tables/scores_{recording}.csv",
            "stability of every feature, simulated and over the conditions of a recording",
            "Scores compared with {recording}",
            "Recordings",
            "stability_beside",
        ),
        stage="recordings",
    ),
    *_made_by(
        "match_noise",
        Output("matched_level", "noise/{noise}.json", "A of a noise level matched to a recording"),
        stage="recordings",
    ),
    *_made_by(
        "compare",
        Output("comparison", "tables/comparison_{comparison}.csv", "every feature and ROI compared with a recording"),
        Output("comparison_features", "tables/comparison_{comparison}_features.csv", "the comparison by feature"),
        Output(
            "comparison_families", "tables/comparison_{comparison}_families.csv", "the comparison by family of features"
        ),
        stage="recordings",
    ),
    *_made_by(
        "change_properties",
        Output("properties", "diagnosis/{comparison}/properties.csv", "features after a change of one image property"),
        stage="recordings",
    ),
    # Diagnosis
    *_made_by(
        "diagnose",
        Output("diagnosis", "diagnosis/{recording}/diagnosis.json", "verdict, findings and their evidence"),
        Output("found_physics", "diagnosis/{recording}/physics.yaml", "the effects found, as a configuration"),
        Output(
            "diagnosis_report",
            "diagnosis/{recording}/report.html",
            "the diagnosis as a page",
            "{recording}",
            "Diagnosis",
            "diagnosis",
        ),
        Output("diagnosis_maps", "diagnosis/{recording}/maps", "maps of the differences, by domain"),
        Output("setup", "diagnosis/{recording}/setup.json", "check of the scan set-up"),
    ),
    *_made_by(
        "diagnose_scanner",
        Output(
            "scanner_diagnosis",
            "diagnosis/scanners/{scanner}/scanner.json",
            "effects that all recordings of a scanner share",
        ),
        Output(
            "scanner_physics",
            "diagnosis/scanners/{scanner}/physics.yaml",
            "the physics of a scanner, as a configuration",
        ),
        Output(
            "scanner_report",
            "diagnosis/scanners/{scanner}/report.html",
            "the diagnosis of a scanner as a page",
            "{scanner}",
            "Diagnosis",
            "diagnosis",
        ),
    ),
    *_made_by(
        "next_of_recording",
        Output(
            "next_measurement",
            "diagnosis/{recording}/next_measurement",
            "candidate recordings ranked by their information (ranking.csv, .png, .pdf), similarity of effects "
            "(alike.csv), and a recording.yaml to fill in for the first",
        ),
    ),
    *_made_by(
        "next_of_scanner",
        Output(
            "scanner_next_measurement",
            "diagnosis/scanners/{scanner}/next_measurement",
            "next_measurement for all recordings of a scanner",
        ),
    ),
    *_made_by(
        "diagnose_features",
        Output(
            "feature_diagnosis",
            "diagnosis/{comparison}/diagnosis.json",
            "verdict, findings and their evidence of a comparison of features",
        ),
        Output(
            "feature_physics",
            "diagnosis/{comparison}/physics.yaml",
            "the image property that differs, as a configuration",
        ),
        Output(
            "feature_report",
            "diagnosis/{comparison}/report.html",
            "the diagnosis of a comparison as a page",
            "{comparison}",
            "Diagnosis",
            "diagnosis",
        ),
        Output("feature_maps", "diagnosis/{comparison}/maps", "maps of a comparison, by domain"),
    ),
    # Blind validation
    *_made_by(
        "proof_phantom",
        Output("proof_image", "proof/phantoms/{phantom}/image.nii.gz", "the phantom as known to the diagnosis"),
        Output("proof_fine", "proof/phantoms/{phantom}/fine.nii.gz", "the phantom as it is scanned"),
        Output("proof_table", "proof/phantoms/{phantom}/rois.csv", "its ROIs, one row each"),
        Output("proof_rois", "proof/phantoms/{phantom}/rois", "masks of its ROIs"),
    ),
    *_made_by(
        "proof_seal",
        Output("sealed", "proof/sealed/{case}.json", "the hidden effects of a case, drawn at random and sealed"),
        Output("seals", "proof/seals.json", "the hashes of all seals"),
    ),
    *_made_by(
        "proof_scan",
        Output("proof_recording", "proof/recordings/{case}", "the recording of a case"),
        Output("proof_held_out", "proof/held_out_protocol/{case}", "the scan of a case with another protocol"),
    ),
    *_made_by(
        "proof_diagnosis",
        Output(
            "proof_diagnosis", "proof/diagnosis/{case}/diagnosis.json", "verdict, findings and their evidence of a case"
        ),
        Output(
            "proof_physics", "proof/diagnosis/{case}/physics.yaml", "the effects found in a case, as a configuration"
        ),
        Output("proof_report", "proof/diagnosis/{case}/report.html", "the diagnosis of a case as a page"),
        Output("proof_maps", "proof/diagnosis/{case}/maps", "maps of the differences of a case"),
    ),
    *_made_by(
        "proof_elsewhere",
        Output(
            "proof_elsewhere",
            "proof/diagnosis/{case}/held_out_protocol.json",
            "the physics found, compared with the scan with another protocol",
        ),
    ),
    *_made_by(
        "proof_verdicts",
        Output("verdict", "proof/verdicts/{case}.json", "a diagnosis, fixed by hashes before its seal is opened"),
    ),
    *_made_by(
        "proof_score",
        Output("score", "proof/score.json", "opened seals and scores"),
        Output("score_page", "proof/score.html", "the score as a page", section="Proof", caption="proof"),
        Output("confusion", "proof/figures/confusion", "hidden and named effects", suffixes=PICTURES),
        Output(
            "before_after", "proof/figures/before_after", "one case before and after its finding", suffixes=PICTURES
        ),
    ),
    # Exports and pages
    *_made_by(
        "dicom_series",
        Output("series", "dicom/{protocol}/{noise}/seed{seed}/series", "an image as a DICOM series"),
        Output("segments", "dicom/{protocol}/{noise}/seed{seed}/rois.dcm", "the image's ROIs as a DICOM SEG"),
    ),
    *_made_by(
        "index_page",
        Output("index", "index.html", "page to open first: results, warnings, figures, tables, and the next commands"),
        stage="tables",
        counted=None,
    ),
    *_made_by("viewer_page", Output("viewer", "viewer.html", "viewer of slices")),
    *_made_by("study_report", Output("report", "report.html", "figures and tables of the study on one page")),
    *_made_by(
        "plan_files",
        Output("plan_table", "plan.csv", "expected jobs, core-hours and bytes by rule"),
        Output("plan_totals", "plan.json", "totals of the plan"),
        Output("plan_text", "plan.txt", "the plan as text"),
    ),
)
BY_NAME = {output.name: output for output in OUTPUTS}
NAMES = tuple(BY_NAME)


def by_path(path: str) -> Output:
    """Return the row of the table for a path.

    Parameters
    ----------
    path : str
        Path below results_dir, with wildcards in braces.

    Raises
    ------
    KeyError
        If no row has this path.
    """
    for output in OUTPUTS:
        if path in output.paths():
            return output
    raise KeyError(f"{path}: no row of the table of outputs")


@dataclass(frozen=True)
class Files:
    """Paths of the files of one study, with unknown wildcards in braces as in Snakemake rules.

    Attributes
    ----------
    results : str
        results_dir of the study.
    """

    results: str

    def __call__(self, name: str, suffix: str = "", **known: str) -> str:
        """Return the path of an output by its name in the table, with the suffix if it has several files.

        Parameters
        ----------
        **known : str
            Wildcards.

        Raises
        ------
        KeyError
            For an unknown output or suffix.
        """
        output = BY_NAME[name]
        if suffix not in output.suffixes:
            raise KeyError(f"{name}: '{suffix}' is none of {output.suffixes}")
        return f"{self.results}/{filled(output.pattern, **known)}{suffix}"

    def benchmark(self, job: str, **known: str) -> str:
        """Return the file with Snakemake's benchmark of a job."""
        return f"{self.results}/logs/{filled(job, **known)}.benchmark.tsv"
