"""X-ray spectra, materials and detector sensors."""
