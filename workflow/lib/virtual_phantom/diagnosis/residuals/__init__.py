"""Recordings prepared for fits, and tests for structure in their residuals."""

KINDS = "kinds of change"  # domain of kinds of change, without locations (verdict.unmodeled)
