"""Callbacks that XCIST finds by name: one module per callback, with a function of the same name.

They add physics that XCIST lacks, from equations of this package. Settings come from `cfg.hooks`.
"""
