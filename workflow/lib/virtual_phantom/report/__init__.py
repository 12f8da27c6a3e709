"""HTML pages of the study, the viewer, the diagnoses and the blind validation, each a self-contained file."""

from ..base.plotting import import_matplotlib

import_matplotlib()
