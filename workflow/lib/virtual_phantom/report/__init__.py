"""Pages, one HTML file each with all that they need inside: the study, the viewer, a diagnosis, the proof."""

from ..base.plotting import import_matplotlib

import_matplotlib()
