"""Table of all files that the workflow makes, which targets, the plan, the report and the reference page read.

Rules state the same paths, so that their files show what they make; tests/workflow/test_outputs.py compares both. Logs
and benchmarks are not in the table: they lie in `logs` and are named after their jobs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

WILDCARD = re.compile(r"\{(\w+)\}")
PICTURES = (".png", ".pdf")  # formats of figures
PCA = ("sirt", "fbp", "multicentre")  # selections that analyses.pca may have


@dataclass(frozen=True)
class Output:
    """One kind of file or folder.

    Attributes
    ----------
    name : str
        Name in the code.
    pattern : str
        Path below results_dir, with wildcards in braces.
    what : str
        Content of the file.
    title : str or None
        Title in the report. Default: the file name.
    section : str or None
        Section of Snakemake's report and, for figures, of the report page. None: in no report.
    caption : str or None
        Caption file in workflow/report, without suffix. Default: the name of the described file.
    suffixes : tuple of str
        Suffixes of an output of several files.
    rule : str
        Rule that makes the file, without its number.
    stage : str or None
        Stage of the jobs in a plan, and name of their rates; the configuration may add to it (costs.jobs.Sizes).
        None: not planned.
    counted : str or None
        Kind of file whose rate gives the bytes that a job writes. None: not counted.
    """

    name: str
    pattern: str
    what: str
    title: str | None = None
    section: str | None = None
    caption: str | None = None
    suffixes: tuple[str, ...] = ("",)
    rule: str = ""
    stage: str | None = None
    counted: str | None = None

    def paths(self, **known: str) -> tuple[str, ...]:
        """Return the paths below results_dir; wildcards that are not given stay in braces."""
        return tuple(filled(self.pattern, **known) + suffix for suffix in self.suffixes)

    def caption_file(self, **known: str) -> str:
        """Return the name of the caption file in workflow/report."""
        return f"{self.caption or PurePosixPath(filled(self.pattern, **known)).stem}.rst"


def filled(pattern: str, **known: str) -> str:
    """Replace wildcards in a pattern."""
    return WILDCARD.sub(lambda match: str(known.get(match[1], match[0])), pattern)


def _made_by(rule: str, *outputs: Output, stage: str | None = None, counted: str | None = None) -> tuple[Output, ...]:
    return tuple(replace(output, rule=rule, stage=stage, counted=counted) for output in outputs)


def _figure(
    pattern: str, section: str, title: str, what: str, *, name: str = "", caption: str | None = None, stage="figures"
) -> tuple[Output, ...]:
    """A figure, whose rule is called as it is."""
    name = f"figure_{name or pattern}"
    output = Output(name, f"figures/{pattern}", what, title, section, caption, PICTURES)
    return _made_by(name, output, stage=stage, counted=stage and "figures")


# Tables with a title: in the order of our report.
OUTPUTS = (
    *_made_by(
        "phantom",
        Output("phantom_image", "phantom/image.nii.gz", "the phantom in HU, on the grid of the images"),
        Output("phantom_fine", "phantom/fine.nii.gz", "the phantom on finer voxels, which are scanned"),
        Output("phantom_table", "phantom/rois.csv", "the phantom's ROIs, a row each"),
        Output("phantom_rois", "phantom/rois", "masks of the ROIs"),
        stage="phantom",
        counted="phantom",
    ),
    *_made_by(
        "rois_on_voxels",
        Output("voxel_table", "phantom/{voxels}/rois.csv", "the phantom's ROIs on a scanner's voxels, a row each"),
        Output("voxel_rois", "phantom/{voxels}/rois", "masks of these ROIs"),
        stage="phantom",
        counted="tables",
    ),
    *_made_by(
        "positions",
        Output("positions", "phantom/positions.csv", "where the phantom lies in every repeat of every noise level"),
        stage="tables",
        counted="tables",
    ),
    *_made_by(
        "rois_moved",
        Output(
            "moved_table", "phantom/moved/seed{seed}/{voxels}/rois.csv", "ROIs of a re-positioned phantom, a row each"
        ),
        Output("moved_rois", "phantom/moved/seed{seed}/{voxels}/rois", "masks of these ROIs"),
        stage="phantom",
        counted="tables",
    ),
    *_made_by(
        "mean_scan",
        Output("mean_scan", "public_scans/mean.nii.gz", "the mean of public scans, HU, without the table"),
        Output("mean_regions", "public_scans/regions.nii.gz", "the regions of these scans, as most of them have them"),
        Output("mean_table", "public_scans/scans.csv", "where the object lies in each of these scans, and their noise"),
        Output("mean_spectra", "public_scans/spectra.csv", "power of the mean and of its noise, by spatial frequency"),
    ),
    *_made_by(
        "without_own_blur",
        Output("sharp_scan", "public_scans/sharp.nii.gz", "the mean without the blur and noise of its own scanner"),
        Output("own_blur", "public_scans/own_blur.csv", "what of the mean that changes: resolution, SDs of regions"),
    ),
    *_made_by(
        "scan_features",
        Output("scan_features", "public_scans/features/{scan}.csv", "features of one public scan, a row per ROI"),
        Output("scan_features_2d", "public_scans/features_2d/{scan}.csv", "the same of each ROI's largest section"),
    ),
    *_made_by(
        "compared_features",
        Output("compared_features", "public_scans/compared/features.csv", "features of the public scans compared with"),
        Output("compared_document", "public_scans/compared/recording.yaml", "these features as a recording"),
        Output("compared_features_2d", "public_scans/compared_2d/features.csv", "the same of largest sections"),
        Output("compared_document_2d", "public_scans/compared_2d/recording.yaml", "these features as a recording"),
    ),
    *_made_by(
        "compile_kernels",
        Output("kernels", "logs/kernels/{lanes}.txt", "a mark: kernels for so many realisations are compiled"),
        stage="compile_kernels",
    ),
    *_made_by(
        "project",
        Output("clean", "projections/{geometry}/clean.h5", "line integrals without noise"),
        stage="project",
        counted="clean projections",
    ),
    *_made_by(
        "project_moved",
        Output(
            "moved_clean",
            "projections/{geometry}/clean_seed{seed}.h5",
            "line integrals without noise of a re-positioned repeat",
        ),
        stage="project",
        counted="clean projections",
    ),
    *_made_by(
        "acquire",
        Output("acquisition", "projections/{geometry}/{noise}/seed{seed}.h5", "projections of one acquisition"),
        stage="acquire",
        counted="noisy projections",
    ),
    *_made_by(
        "reconstruct",
        Output("image", "images/{protocol}/{noise}/seed{seed}.nii.gz", "the image of one acquisition, HU"),
        stage="reconstruct",
        counted="images",
    ),
    *_made_by(
        "extract",
        Output("image_features", "features/{protocol}/{noise}/seed{seed}.csv", "features of one image, a row per ROI"),
        stage="extract",
        counted="features",
    ),
    # The study's figures.
    *_figure("rois", "Phantom", "Regions of interest", "the ROIs on the phantom"),
    *_figure("scans", "Phantom", "Input, FBP and SIRT", "axial views, and what differs from the input"),
    *_figure("noise_calibration", "Noise", "Noise calibration", "image variance against the noise level A"),
    *_figure(
        "stability_discrimination",
        "Stability",
        "Stability and discriminative power",
        "each feature's stability against its discriminative power",
    ),
    *_figure(
        "overlap",
        "Stability",
        "Overlap with the measured phantom",
        "how many of the best features are also the measured phantom's best",
    ),
    *_figure(
        "physics_change",
        "Stability",
        "With physics and without",
        "which features' stability changes by the physics",
    ),
    *_figure(
        "overlap_{recording}",
        "Recordings",
        "Overlap with {recording}",
        "how many of the best features are also a recording's best",
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
        "Wider noise range (multi-centre)",
        "principal components over more noise levels",
    ),
    *_figure(
        "comparison_{comparison}",
        "Recordings",
        "Comparison {comparison}",
        "every feature and ROI against a recording's",
        name="comparison",
        caption="comparison",
        stage="recordings",
    ),
    # The study's tables.
    *_made_by(
        "trust",
        Output(
            "trust",
            "tables/trust.csv",
            "which features to trust: stability with its interval, what it rests on, and a sentence",
            "Which features to trust",
            "Stability",
        ),
        stage="trust",
        counted="tables",
    ),
    *_made_by(
        "physics_change",
        Output(
            "physics_change",
            "tables/physics_change.csv",
            "the stability of every feature with the study's physics and without",
            "Stability with physics and without",
            "Stability",
        ),
        stage="trust",
        counted="tables",
    ),
    *_made_by(
        "stability_measures",
        Output(
            "stable_features",
            "tables/stable_features.csv",
            "which features are stable by which measure",
            "Stable features by measure",
            "Stability",
            "stability_measures",
        ),
        Output(
            "stability_measures",
            "tables/stability_measures.csv",
            "ICC, CCC and coefficients of variation beside W",
            "Measures of stability",
            "Stability",
        ),
        stage="tables",
        counted="tables",
    ),
    *_made_by(
        "stability",
        Output(
            "stability",
            "tables/stability.csv",
            "W over pairs of groups and of ROIs",
            "Stability and discriminative power by W",
        ),
        stage="tables",
        counted="tables",
    ),
    *_made_by(
        "top_features",
        Output(
            "top_features",
            "tables/top_features.csv",
            "the ten best features beside the paper's",
            "Ten best features",
            "Stability",
        ),
        stage="tables",
        counted="tables",
    ),
    *_made_by(
        "overlap",
        Output(
            "overlap",
            "tables/overlap.csv",
            "how many of the best features are also the measured phantom's best",
            "Overlap with the measured phantom",
        ),
        stage="tables",
        counted="tables",
    ),
    *_made_by(
        "noise_calibration",
        Output(
            "noise_calibration",
            "tables/noise_calibration.csv",
            "image variance against the noise level A",
            "Noise calibration",
        ),
        stage="noise_calibration",
        counted="tables",
    ),
    *_made_by(
        "matched_noise",
        Output(
            "matched_noise",
            "tables/matched_noise.csv",
            "how well matched levels meet their recordings",
            "Matched noise levels",
            "Recordings",
        ),
        stage="recordings",
        counted="tables",
    ),
    *_made_by(
        "merge_features",
        Output("features", "features.csv", "features of all images, a row per image and ROI", "All features"),
        stage="merge_features",
        counted="features",
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
            "how far principal components tell classes apart",
            "Separability of classes: {pca}",
        ),
        stage="tables",
        counted="tables",
    ),
    *_made_by(
        "parquet",
        Output("parquet", "{table}.parquet", "a table as Parquet too"),
        stage="parquet",
        counted="tables",
    ),
    # Recordings, and the study beside them.
    *_made_by(
        "download_htc2022",
        Output("sinogram", "downloads/htc2022_{disc}", "a sinogram of the Helsinki challenge as a recording"),
    ),
    *_made_by(
        "recording_summary",
        Output("summary", "recordings/{recording}/summary.json", "what a recording holds and says of the scan"),
    ),
    *_made_by("recordings", Output("recordings", "recordings/recordings.csv", "all recordings, a row each")),
    *_figure(
        "recording_{recording}",
        "Recordings",
        "Recording {recording}",
        "what a recording of projections or images looks like",
        name="recording",
        caption="recording",
        stage=None,
    ),
    *_made_by(
        "align_recording",
        Output("alignment", "recordings/{recording}/alignment.json", "where the phantom lies in a recording of images"),
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
        counted="tables",
    ),
    *_made_by(
        "recording_scores",
        Output(
            "scores",
            "recordings/{recording}/scores.csv",
            "stability and discriminative power of a recording's features",
        ),
        stage="recordings",
        counted="tables",
    ),
    *_made_by(
        "overlap_recording",
        Output("overlap_recording", "tables/overlap_{recording}.csv", "the overlap with a recording's best features"),
        stage="recordings",
        counted="tables",
    ),
    *_made_by(
        "stability_beside",
        Output(
            "stability_beside",
            "tables/scores_{recording}.csv",
            "every feature's stability, simulated and over a recording's conditions",
            "Scores beside {recording}",
            "Recordings",
            "stability_beside",
        ),
        stage="recordings",
        counted="tables",
    ),
    *_made_by(
        "match_noise",
        Output("matched_level", "noise/{noise}.json", "the A of a noise level that meets a recording"),
        stage="recordings",
        counted="tables",
    ),
    *_made_by(
        "compare",
        Output("comparison", "tables/comparison_{comparison}.csv", "every feature and ROI against a recording's"),
        Output("comparison_features", "tables/comparison_{comparison}_features.csv", "the comparison by feature"),
        Output(
            "comparison_families", "tables/comparison_{comparison}_families.csv", "the comparison by family of features"
        ),
        stage="recordings",
        counted="tables",
    ),
    *_made_by(
        "change_properties",
        Output("properties", "diagnosis/{comparison}/properties.csv", "features with one property of images changed"),
        stage="recordings",
        counted="tables",
    ),
    # The diagnosis.
    *_made_by(
        "diagnose",
        Output("diagnosis", "diagnosis/{recording}/diagnosis.json", "verdict, findings and their evidence"),
        Output("found_physics", "diagnosis/{recording}/physics.yaml", "the findings as an overlay of a configuration"),
        Output(
            "diagnosis_report",
            "diagnosis/{recording}/report.html",
            "the diagnosis as a page",
            "{recording}",
            "Diagnosis",
            "diagnosis",
        ),
        Output("diagnosis_maps", "diagnosis/{recording}/maps", "maps of the differences, by domain"),
        Output("setup", "diagnosis/{recording}/setup.json", "whether the scan is described right"),
    ),
    *_made_by(
        "diagnose_scanner",
        Output("scanner_diagnosis", "diagnosis/scanners/{scanner}/scanner.json", "what a scanner's recordings share"),
        Output(
            "scanner_physics",
            "diagnosis/scanners/{scanner}/physics.yaml",
            "a scanner's physics as an overlay of a configuration",
        ),
        Output(
            "scanner_report",
            "diagnosis/scanners/{scanner}/report.html",
            "a scanner's diagnosis as a page",
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
            "further recordings ranked by what they would tell (ranking.csv, .png, .pdf), how alike effects are "
            "(alike.csv), and the first one's recording.yaml to fill in",
        ),
    ),
    *_made_by(
        "next_of_scanner",
        Output(
            "scanner_next_measurement",
            "diagnosis/scanners/{scanner}/next_measurement",
            "the same of all recordings of a scanner together",
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
            "the property of images that differs, as an overlay of a configuration",
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
    # The proof.
    *_made_by(
        "proof_phantom",
        Output("proof_image", "proof/phantoms/{phantom}/image.nii.gz", "what the diagnosis is told of a phantom"),
        Output("proof_fine", "proof/phantoms/{phantom}/fine.nii.gz", "the phantom that is scanned"),
        Output("proof_table", "proof/phantoms/{phantom}/rois.csv", "its ROIs, a row each"),
        Output("proof_rois", "proof/phantoms/{phantom}/rois", "masks of its ROIs"),
    ),
    *_made_by(
        "proof_seal",
        Output("sealed", "proof/sealed/{case}.json", "what is concealed in a case, drawn and sealed"),
        Output("seals", "proof/seals.json", "the hashes of all seals"),
    ),
    *_made_by(
        "proof_scan",
        Output("proof_recording", "proof/recordings/{case}", "the recording of a case"),
        Output("proof_held_out", "proof/held_out_protocol/{case}", "the scan of a case by another protocol"),
    ),
    *_made_by(
        "proof_diagnosis",
        Output(
            "proof_diagnosis", "proof/diagnosis/{case}/diagnosis.json", "verdict, findings and their evidence of a case"
        ),
        Output(
            "proof_physics",
            "proof/diagnosis/{case}/physics.yaml",
            "the findings of a case as an overlay of a configuration",
        ),
        Output("proof_report", "proof/diagnosis/{case}/report.html", "the diagnosis of a case as a page"),
        Output("proof_maps", "proof/diagnosis/{case}/maps", "maps of the differences of a case"),
    ),
    *_made_by(
        "proof_elsewhere",
        Output(
            "proof_elsewhere",
            "proof/diagnosis/{case}/held_out_protocol.json",
            "the physics found, held against the scan by another protocol",
        ),
    ),
    *_made_by(
        "proof_verdicts",
        Output("verdict", "proof/verdicts/{case}.json", "a diagnosis, bound by hashes before its seal is opened"),
    ),
    *_made_by(
        "proof_score",
        Output("score", "proof/score.json", "the seals opened, and all of it scored"),
        Output("score_page", "proof/score.html", "the score as a page", section="Proof", caption="proof"),
        Output("confusion", "proof/figures/confusion", "what was concealed and what was named", suffixes=PICTURES),
        Output(
            "before_after", "proof/figures/before_after", "one case before and after its finding", suffixes=PICTURES
        ),
    ),
    # For other programs, and for people.
    *_made_by(
        "dicom_series",
        Output("series", "dicom/{protocol}/{noise}/seed{seed}/series", "an image as a DICOM series"),
        Output("segments", "dicom/{protocol}/{noise}/seed{seed}/rois.dcm", "the image's ROIs as a DICOM SEG"),
    ),
    *_made_by(
        "index_page",
        Output("index", "index.html", "start here: the answer, warnings, figures, tables, and the next commands"),
        stage="tables",
    ),
    *_made_by("viewer_page", Output("viewer", "viewer.html", "slices to flip through")),
    *_made_by("study_report", Output("report", "report.html", "figures and tables of the study in one page")),
    *_made_by(
        "plan_files",
        Output("plan_table", "plan.csv", "jobs, core-hours and bytes that the study would take, by rule"),
        Output("plan_totals", "plan.json", "the plan in all, for programs"),
        Output("plan_text", "plan.txt", "the plan, to be read"),
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
    """Paths of one study's files, as Snakemake takes them: wildcards that are not given stay in braces.

    Attributes
    ----------
    results : str
        Its results_dir.
    """

    results: str

    def __call__(self, name: str, suffix: str = "", **known: str) -> str:
        """An output by its name in the table; of several files the one with that suffix.

        Parameters
        ----------
        **known : str
            Wildcards.

        Raises
        ------
        KeyError
            For an output that is not in the table.
        """
        output = BY_NAME[name]
        if suffix not in output.suffixes:
            raise KeyError(f"{name}: '{suffix}' is none of {output.suffixes}")
        return f"{self.results}/{filled(output.pattern, **known)}{suffix}"

    def benchmark(self, job: str, **known: str) -> str:
        """Return the file to which Snakemake writes the duration and memory of a job."""
        return f"{self.results}/logs/{filled(job, **known)}.benchmark.tsv"
