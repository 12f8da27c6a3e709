"""Public scans of the printed phantom: which there are, bringing them here, and finding their files by their tags."""
