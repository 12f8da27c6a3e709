"""Comparison of verdicts with the hidden effects after the seals are opened."""
