"""Reference pages that are made from the code when the site is built. docs/site_pages.py adds them to it."""

from generators import api, configuration, effects, licenses, objects, output_files, thresholds, validation_tables

# {path in docs/: function that returns the page}
PAGES = {
    "reference/configuration.md": configuration.page,
    "reference/effects.md": effects.page,
    "reference/objects.md": objects.page,
    "reference/files.md": output_files.page,
    "reference/python.md": api.page,
    "reference/thresholds.md": thresholds.page,
    "reference/licenses.md": licenses.page,
    "reference/validation-record.md": validation_tables.page,
}
