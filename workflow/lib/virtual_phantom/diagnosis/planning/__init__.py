"""Rank further measurements by what they are expected to distinguish."""
