"""What a study costs before it is run: its jobs, how much each has to do and to write, and measured rates of both."""
