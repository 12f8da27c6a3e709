"""Pages, one HTML file each with all that they need inside: the study, the viewer, a diagnosis, the proof."""
