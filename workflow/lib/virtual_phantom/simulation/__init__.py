"""Main path of a study: project, acquire, reconstruct."""
