"""Locate mismatches between recordings and the simulator, and name the missing physics.

`run` is the entry point. `preparation` makes a configured recording ready for fits. Recordings of `projections` and of
`images` are condensed in `noise`, fitted in `fitting`, tested in `residuals`; `selection` adds effects as long as
held-out data support them, `uncertainty` gives intervals, `verdict` states the result, and `comparison` judges it in
images. `scanner` diagnoses several recordings together, `planning` ranks further measurements, `setup` checks the
description of a scan, and `features` diagnoses tables of features.
"""
