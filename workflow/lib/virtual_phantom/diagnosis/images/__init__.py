"""Diagnosis of recorded images: the scan is simulated and reconstructed, and whitened voxels are compared."""
