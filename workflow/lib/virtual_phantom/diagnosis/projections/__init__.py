"""Diagnosis of projections: what was recorded, what the acquisition chain predicts, and how sure both are."""
