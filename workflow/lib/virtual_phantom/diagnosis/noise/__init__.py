"""Noise of recordings: covariance, whitening, and gain patterns."""
