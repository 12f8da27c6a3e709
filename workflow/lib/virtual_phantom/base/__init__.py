"""Errors, units, geometry, settings and random streams. All other packages may import this one; it imports none."""
