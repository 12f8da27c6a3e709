"""Cost of a study before it runs: its jobs, their amounts of work and output, and measured rates."""
