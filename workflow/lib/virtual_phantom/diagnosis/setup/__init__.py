"""Check of the scan set-up before any physics is fitted: geometry, object and data of a recording."""
