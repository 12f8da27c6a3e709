"""Least-squares fits of the acquisition model to recordings."""
