"""Checks of a study that run before anything is computed."""
