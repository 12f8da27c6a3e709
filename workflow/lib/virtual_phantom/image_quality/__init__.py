"""Image quality of phantom scans after AAPM Report 233: resolution, noise, HU accuracy and uniformity."""
