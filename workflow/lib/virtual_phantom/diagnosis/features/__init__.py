"""Diagnosis of tables of features: which property of the images explains how they differ."""
