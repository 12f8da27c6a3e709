"""Recordings of an independent simulator with hidden effects, whose truths are sealed."""
