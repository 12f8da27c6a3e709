"""The main path of a study: project, acquire, reconstruct."""
