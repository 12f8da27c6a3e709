"""Confidence intervals of fitted parameters, and model error."""
