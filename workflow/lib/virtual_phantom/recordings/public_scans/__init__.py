"""Public scans of the printed phantom: list, download, and identification of files by their DICOM tags."""
