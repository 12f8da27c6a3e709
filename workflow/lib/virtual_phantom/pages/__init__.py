"""Pages of the study: one HTML file each, with all that they need inside."""
