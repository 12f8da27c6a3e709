# Public scans of the printed phantom (docs/how-to/printed-phantom.md). Other rules treat them like scans that a user has
# added.
import sys

from virtual_phantom.study.context import or_exit

scans = context.scans

# Report the size of the download before it starts, in dry runs, too.
if workflow.is_main_process and (announced := scans.fetch_text()):
    print(announced, file=sys.stderr)

# Only missing scans have a rule, so that Snakemake neither fetches nor deletes existing scans.
if scans.absent and context.study.downloads.scans is None:

    rule fetch_scan:
        """Fetch one public scan of the printed phantom: CT, regions and license."""
        output:
            (
                directory(scans.scan_folder)
                if context.study.keep_scans
                else temp(directory(scans.scan_folder))
            ),
        log:
            results("logs/fetch/{scan}.log"),
        wildcard_constraints:
            scan="|".join(scan.name for scan in scans.absent),
        resources:
            mem_mb=500,
            runtime=120,
        params:
            listed=lambda wildcards: scans.series_text(wildcards.scan),
            scan=lambda wildcards: scans.by_name(wildcards.scan),
            endpoint=context.study.downloads.endpoint,
            bucket=context.study.downloads.bucket,
        message:
            "{params.listed}"
        script:
            "../scripts/fetch_scan.py"

elif scans.absent:

    rule link_scans:
        """Link to the scans in a folder of the user."""
        output:
            [directory(folder) for folder in scans.folders(scans.absent)],
        log:
            results("logs/link_scans.log"),
        resources:
            mem_mb=1000,
            runtime=120,
        params:
            folder=context.study.downloads.scans,
            scans=scans.absent,
        script:
            "../scripts/link_scans.py"


rule fetch:
    """Fetch all public scans that the configuration uses."""
    input:
        or_exit(lambda wildcards: scans.fetched()),
    localrule: True


rule scan_features:
    """Features of one public scan on its own voxels and regions, in 3D and 2D."""
    input:
        scan=scans.scan_folder,
        parameters=context.parameter_files,
    output:
        results("public_scans/features/{scan}.csv"),
        results("public_scans/features_2d/{scan}.csv"),
    log:
        results("logs/scan_features/{scan}.log"),
    wildcard_constraints:
        scan="|".join(scan.name for scan in scans.scans) or "none",
    # Runs before further scans are fetched, since scans that are not kept are deleted after this rule.
    priority: 1
    resources:
        mem_mb=4000,
        runtime=60,
    params:
        scan=lambda wildcards: scans.by_name(wildcards.scan),
        rois=to_mapping(scans.rois),
        regions=context.study.public_scans.regions,
        parameters=context.parameters,
        code=code("scan_features.py"),
    script:
        "../scripts/scan_features.py"


rule compared_features:
    """Features of all public scans of the comparison, as a recording."""
    input:
        tables=scans.feature_tables("scan_features"),
        tables_2d=scans.feature_tables("scan_features_2d"),
    output:
        features=results("public_scans/compared/features.csv"),
        document=results("public_scans/compared/recording.yaml"),
        features_2d=results("public_scans/compared_2d/features.csv"),
        document_2d=results("public_scans/compared_2d/recording.yaml"),
    log:
        results("logs/compared_features.log"),
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        scans=scans.compared,
        code=code("compared_features.py"),
    script:
        "../scripts/compared_features.py"


rule public_features:
    """Features of all public scans of the comparison, without a study."""
    input:
        or_exit(lambda wildcards: scans.recordings()),
    localrule: True
