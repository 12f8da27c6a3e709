"""Source and detector distances in tests of geometry and projection."""

SCANNER = dict(source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0)  # magnifies twice
