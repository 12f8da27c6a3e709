"""Statistics of the study: stability, discriminative power, rankings, principal components and noise.

The constants are defined here so that the configuration can check them without loading scipy and pandas.
"""

MINIMUM_REPEATS = 3  # repeats for a variance and its error (noise.repeat_variance)
MINIMUM_LEVELS = 3  # noise levels for a line and its error (noise.match_noise_level)
COMPARED_REPEATS = 2  # repeats for a mean and an SD (comparison)
RANKSUM_REPEATS = 2  # repeats for a rank-sum test (wilcoxon)

# Kinds of change that every study may have. The others are named after the settings that differ (study/changes.py).
REPEATS = "random repeats"  # nothing but noise and start angle
REPOSITIONING = "re-positioning"
ANY_PROTOCOL = "any two protocols"  # all pairs of protocols of the stability analysis
EXTRACTION = "extraction settings"  # of the same images
