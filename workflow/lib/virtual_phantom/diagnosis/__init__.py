"""Where a recording and the simulator differ beyond noise, and which physics was left out.

`observed` condenses repeats to means, variances and correlations; `model` predicts them from the acquisition chain;
`fit` fits effects with the alignment that every model gets; `locate` tests what is left; `attribute` chooses effects by
data that were not fitted; `verdict` says it.

Of tables of features: `properties` changes one property of the simulated images at a time, `responses` orders what that
does to the features, `features` fits and judges, `feature_places` tests, `feature_verdict` says it.
"""
