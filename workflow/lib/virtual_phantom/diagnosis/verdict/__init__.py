"""The verdict of a diagnosis, its warnings, and the unexplained mismatch."""
