"""Files, settings, costs and progress of the jobs of a study."""
