"""Recordings of an independent simulator, in which physics is concealed and sealed."""
