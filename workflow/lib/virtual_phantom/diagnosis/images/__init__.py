"""Diagnosis of recordings of images: the scan is simulated, reconstructed alike, and compared in whitened voxels."""
