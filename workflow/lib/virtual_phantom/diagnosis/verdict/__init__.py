"""The verdict of a diagnosis, its warnings, and what stays unexplained."""
