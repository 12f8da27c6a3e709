"""Where a recording and the simulator differ beyond noise, and which physics was left out.

`core` fits, chooses and judges; `projections`, `images` and `features` say what was recorded, and what a simulation
predicts of it.

Of projections and images: `observed` condenses repeats to means, variances and correlations; `model` predicts them from
the acquisition chain; `core.fit` fits effects with the alignment that every model gets; `core.locate` tests what is
left; `core.attribute` chooses effects by data that were not fitted; `core.verdict` says it.

Of tables of features: `properties` changes one property of the simulated images at a time, `responses` orders what that
does to the features, `choice` fits and judges, `places` tests, `verdict` says it.
"""
