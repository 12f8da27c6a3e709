"""Console output of a run: progress of each stage, estimated time left, and the reasons of failures."""
