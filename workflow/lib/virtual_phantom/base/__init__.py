"""Errors, units, geometry and paths of data. All other packages may import this one; it imports none of them."""
