# Public scans of the printed phantom. docs/how-to/printed-phantom.md says what they are. Nothing after these rules knows whether
# a scan was fetched or is somebody's own.
import sys

from virtual_phantom.study.context import or_exit

scans = context.scans

# Rehearsals say it too: how much it is, before anything is fetched.
if workflow.is_main_process and (announced := scans.announced()):
    print(announced, file=sys.stderr)

# Rules for what is not here: nothing fetches or deletes a scan that is here.
if scans.absent and scans.own is None:

    rule fetch_scan:
        """One public scan of the printed phantom: its CT, its regions, and whose they are."""
        output:
            (directory(scans.place) if scans.kept else temp(directory(scans.place))),
        log:
            results("logs/fetch/{scan}.log"),
        wildcard_constraints:
            scan="|".join(scan.name for scan in scans.absent),
        resources:
            mem_mb=500,
            runtime=120,
        params:
            listed=lambda wildcards: scans.listed(wildcards.scan),
            scan=lambda wildcards: scans.one(wildcards.scan),
            endpoint=context.config["downloads"]["endpoint"],
            bucket=context.config["downloads"]["bucket"],
        message:
            "{params.listed}"
        script:
            "../scripts/fetch_scan.py"

elif scans.absent:

    rule link_scans:
        """Links to the scans that lie in a folder of somebody's own, which is read once."""
        output:
            [directory(folder) for folder in scans.absent_folders()],
        log:
            results("logs/link_scans.log"),
        resources:
            mem_mb=1000,
            runtime=120,
        params:
            folder=scans.own,
            scans=scans.absent,
        script:
            "../scripts/link_scans.py"


rule fetch:
    """All public scans that the configuration takes."""
    input:
        or_exit(lambda wildcards: scans.fetched()),
    localrule: True


rule scan_features:
    """Features of one public scan, at its own voxels and in its own regions, in three dimensions and in two."""
    input:
        scan=scans.place,
        parameters=context.parameter_files,
    output:
        results("public_scans/features/{scan}.csv"),
        results("public_scans/features_2d/{scan}.csv"),
    log:
        results("logs/scan_features/{scan}.log"),
    wildcard_constraints:
        scan="|".join(scan.name for scan in scans.scans) or "none",
    # Before further scans are fetched: those that are not kept are deleted after it.
    priority: 1
    resources:
        mem_mb=4000,
        runtime=60,
    params:
        scan=lambda wildcards: scans.one(wildcards.scan),
        rois=scans.rois,
        regions=scans.regions,
        parameters=context.parameters,
        code=code("scan_features.py"),
    script:
        "../scripts/scan_features.py"


rule compared_features:
    """Features of all public scans that are compared with, as a recording."""
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
    """Features of all public scans that are compared with, as recordings, without a study."""
    input:
        or_exit(lambda wildcards: scans.recordings()),
    localrule: True
