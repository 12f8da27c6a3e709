"""Files: written whole, with checksums, and read back checked; and the formats of others."""
