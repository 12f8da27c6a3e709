"""Compare recorded and simulated images, and judge whether a difference is relevant."""
