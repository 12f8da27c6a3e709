"""Recordings prepared for fits, and tests for structure in their residuals."""
