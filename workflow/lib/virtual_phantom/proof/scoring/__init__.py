"""Seals opened, and verdicts held against what was concealed."""
