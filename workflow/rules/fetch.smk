# Public scans of the printed phantom. docs/how-to/printed-phantom.md says what they are. Nothing after these rules knows whether
# a scan was fetched or is somebody's own.
import sys

from virtual_phantom.study.context import or_exit

# Rehearsals say it too: how much it is, before anything is fetched.
if workflow.is_main_process and (announced := context.scans.fetch_text()):
    print(announced, file=sys.stderr)

# Rules for what is not here: nothing fetches or deletes a scan that is here.
if context.scans.absent and context.scans.local_folder is None:

    rule fetch_scan:
        """One public scan of the printed phantom: its CT, its regions, and whose they are."""
        output:
            (
                directory(context.scans.scan_folder)
                if context.scans.keep
                else temp(directory(context.scans.scan_folder))
            ),
        log:
            context.log("fetch/{scan}"),
        wildcard_constraints:
            scan="|".join(scan.name for scan in context.scans.absent),
        resources:
            mem_mb=500,
            runtime=120,
        params:
            listed=lambda wildcards: context.scans.series_text(wildcards.scan),
            scan=lambda wildcards: context.scans.by_name(wildcards.scan),
            endpoint=context.config["downloads"]["endpoint"],
            bucket=context.config["downloads"]["bucket"],
        message:
            "{params.listed}"
        script:
            "../scripts/fetch_scan.py"

elif context.scans.absent:

    rule link_scans:
        """Links to the scans that lie in a folder of somebody's own, which is read once."""
        output:
            [directory(folder) for folder in context.scans.absent_folders()],
        log:
            context.log("link_scans"),
        resources:
            mem_mb=1000,
            runtime=120,
        params:
            folder=context.scans.local_folder,
            scans=context.scans.absent,
        script:
            "../scripts/link_scans.py"


rule fetch:
    """All public scans that the configuration takes."""
    input:
        or_exit(lambda wildcards: context.scans.fetched()),
    localrule: True


rule scan_features:
    """Features of one public scan, at its own voxels and in its own regions, in three dimensions and in two."""
    input:
        scan=context.scans.scan_folder,
        parameters=context.parameter_files,
        code=context.code("scan_features.py"),
    output:
        context.file("scan_features"),
        context.file("scan_features_2d"),
    log:
        context.log("scan_features/{scan}"),
    wildcard_constraints:
        scan="|".join(scan.name for scan in context.scans.scans) or "none",
    # Before further scans are fetched: those that are not kept are deleted after it.
    priority: 1
    resources:
        mem_mb=4000,
        runtime=60,
    params:
        scan=lambda wildcards: context.scans.by_name(wildcards.scan),
        rois=context.scans.rois,
        regions=context.scans.regions,
        parameters=context.parameters,
    script:
        "../scripts/scan_features.py"


rule compared_features:
    """Features of all public scans that are compared with, as a recording."""
    input:
        tables=context.scans.feature_tables("scan_features"),
        tables_2d=context.scans.feature_tables("scan_features_2d"),
        code=context.code("compared_features.py"),
    output:
        features=context.file("compared_features"),
        document=context.file("compared_document"),
        features_2d=context.file("compared_features_2d"),
        document_2d=context.file("compared_document_2d"),
    log:
        context.log("compared_features"),
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        scans=context.scans.compared,
    script:
        "../scripts/compared_features.py"


rule public_features:
    """Features of all public scans that are compared with, as recordings, without a study."""
    input:
        or_exit(lambda wildcards: context.scans.recordings()),
    localrule: True
