"""Whether a recording was described right: its geometry, its numbers and its object, before any physics is fitted."""
