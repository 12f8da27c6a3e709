"""Diagnosis of projections: recorded data, predictions of the acquisition chain, and the errors of both."""
