"""Acquisition chain: scenes, beam, effects and noise, from the object to line integrals."""
