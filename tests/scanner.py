"""The source and detector distances that tests of geometry and projection share."""

SCANNER = dict(source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0)  # magnifies twice
