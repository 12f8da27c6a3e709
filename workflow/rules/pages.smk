# Pages for a browser.
import sys

from virtual_phantom.base.errors import InputError, printed
from virtual_phantom.study.context import or_exit
from virtual_phantom.study.index_page import renew

pages = context.pages


rule viewer_page:
    """Slices of the input, FBP, SIRT and what they differ by, to flip through."""
    input:
        unpack(or_exit(lambda wildcards: pages.viewed())),
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
    """Figures, tables that sort and filter, diagnoses and provenance in one page."""
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
        figures=lambda wildcards: pages.shown(),
        tables=pages.table_titles(),
        diagnoses=pages.diagnoses(),
        links=pages.links(),
        config=context.config,
        code=code("report_page.py"),
    script:
        "../scripts/report_page.py"


rule report_page:
    input:
        rules.study_report.output[0],
        rules.viewer_page.output[0] if context.selections.optimal_images() else [],
    localrule: True


rule index_page:
    """The answer, warnings, every figure and table, and what to do next: the page to start with."""
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
        figures=lambda wildcards: pages.shown(),
        tables=pages.table_titles(),
        # All that may be there: the script takes what is, so that nothing is run again for it.
        diagnoses=context.diagnosis.reports(),
        commands=pages.commands(),
        beside=pages.others,
        config=context.config,
        code=code("index_page.py"),
    script:
        "../scripts/index_page.py"


onsuccess:
    # As a job it would be done before what it shows, or ask every study for it.
    try:
        if page := renew(pages, context.config):
            print(f"Start with {page}", file=sys.stderr)
    except InputError as error:
        print(printed(error), file=sys.stderr)
