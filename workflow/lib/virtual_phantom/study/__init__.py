"""The study that a configuration describes: its plan, its jobs, what they cost, and how they are told."""
