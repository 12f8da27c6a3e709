"""Statistics of the study: stability and discriminative power, rankings and their overlap, components,
noise."""
