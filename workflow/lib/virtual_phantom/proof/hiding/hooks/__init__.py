"""Callbacks that XCIST finds by name: one module each, holding a function of the module's name.

They make what XCIST lacks, each from its own equation, and read their settings from `cfg.hooks`.
"""
