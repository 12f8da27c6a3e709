"""Joint diagnosis of several recordings of a scanner."""
