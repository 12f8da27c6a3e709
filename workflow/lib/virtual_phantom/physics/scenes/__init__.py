"""Scanned objects, which return path lengths per material."""
