"""Recordings: measurements in a folder with a recording.yaml, from a real scanner or from a blind test.

`reading.load_recording` returns an ImagesRecording, ProjectionsRecording or FeaturesRecording. `summary` describes its
content, and `importers` convert other formats. The format: docs/how-to/recordings.md.

This module imports nothing: the workflow reads recording.yaml in every job and must not wait for image libraries.
"""
