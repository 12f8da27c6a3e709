"""What diagnoses of projections and images share: fits, screening, the choice of effects, verdicts."""
