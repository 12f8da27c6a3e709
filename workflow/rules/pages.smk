# HTML pages.
import sys

from virtual_phantom.base.errors import InputError, printed
from virtual_phantom.study.context import or_exit
from virtual_phantom.study.index_page import renew

pages = context.pages


rule viewer_page:
    """Viewer of slices: input, FBP, SIRT and their differences."""
    input:
        unpack(or_exit(lambda wildcards: pages.viewer_images())),
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
    output:
        results("viewer.html"),
    log:
        results("logs/viewer.log"),
    resources:
        mem_mb=context.megabytes(volumes=60),
        runtime=15,
    params:
        titles=context.selections.scan_titles(),
        subtitle=lambda wildcards: pages.viewer_subtitle(),
        code=code("viewer.py"),
    script:
        "../scripts/viewer.py"


rule viewer:
    input:
        rules.viewer_page.output[0],
    localrule: True


rule study_report:
    """Report on one page: figures, sortable tables, diagnoses and provenance."""
    input:
        figures=pages.pictures(),
        captions=pages.caption_files(),
        tables=pages.tables(),
    output:
        results("report.html"),
    log:
        results("logs/report_page.log"),
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        figures=lambda wildcards: pages.figures(),
        tables=pages.table_titles(),
        diagnoses=pages.diagnoses(),
        links=pages.links(),
        config=to_mapping(context.study),
        code=code("report_page.py"),
    script:
        "../scripts/report_page.py"


rule report_page:
    input:
        rules.study_report.output[0],
        rules.viewer_page.output[0] if context.selections.optimal_images() else [],
    localrule: True


rule index_page:
    """Start page: result, warnings, figures, tables and the next commands."""
    input:
        figures=pages.pictures(),
        captions=pages.caption_files(),
        tables=pages.tables(),
    output:
        results("index.html"),
    log:
        results("logs/index_page.log"),
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        figures=lambda wildcards: pages.figures(),
        tables=pages.table_titles(),
        # Reports that may exist. They are no inputs: the page links to existing reports without making others.
        diagnoses=context.diagnosis.reports(),
        commands=pages.commands(),
        other_pages=pages.other_pages,
        pairs=pages.setting_pairs(),
        impossible=pages.impossible(),
        config=to_mapping(context.study),
        code=code("index_page.py"),
    script:
        "../scripts/index_page.py"


onsuccess:
    # Not a job: a job would run before the files that the page links to, or make each study produce them.
    try:
        if page := renew(pages, to_mapping(context.study)):
            print(f"Start with {page}", file=sys.stderr)
    except InputError as error:
        print(printed(error), file=sys.stderr)
