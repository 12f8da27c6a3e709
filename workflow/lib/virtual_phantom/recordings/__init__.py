"""Recordings: real or concealed measurements in a folder with a recording.yaml, read and checked.

`reading.load` gives an ImagesRecording, ProjectionsRecording or FeaturesRecording; `summary.summary` says what is in
it; `importers` make such folders from other formats. The format: docs/how-to/recordings.md.

Nothing is imported here: the workflow reads recording.yaml in every job, and must not pay for the readers of images.
"""
