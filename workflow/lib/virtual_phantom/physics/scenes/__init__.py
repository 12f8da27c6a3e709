"""Objects that are scanned, as path lengths per material."""
