"""Random counts and their correlation between neighboring rays."""
