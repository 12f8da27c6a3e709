"""Read, check and plan a study's configuration."""
