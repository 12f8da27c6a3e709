"""What everything else stands on: errors, units, geometry, and where data lie. Imports nothing of ours."""
