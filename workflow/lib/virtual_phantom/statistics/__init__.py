"""Statistics of the study: stability and discriminative power, rankings and their overlap, components, noise."""

# Here and not where they are needed: the configuration knows them without loading scipy and pandas.
MINIMUM_REPEATS = 3  # of a variance and its error (noise.repeat_variance)
MINIMUM_LEVELS = 3  # of a line and its error (noise.match)
COMPARED_REPEATS = 2  # of a mean and an SD over repeats (comparison)
RANKSUM_REPEATS = 2  # of a sample whose spread the rank-sum test compares (wilcoxon)
