"""Locate mismatches between recordings and the simulator, and name the missing physics.

`run` is the entry point, `setup` checks the description of a scan, and `preparation` prepares recordings of
`projections` or `images` for fits. `noise` condenses repeats, `fitting` fits models, `residuals` tests them, and
`selection` adds effects while held-out data support them. `uncertainty` gives intervals, `verdict` states the result,
and `comparison` judges it in images. `scanner` diagnoses several recordings, `planning` ranks measurements, and
`features` diagnoses tables of features.
"""
