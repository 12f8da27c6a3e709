"""Diagnosis of feature tables: the image property that explains their differences."""
