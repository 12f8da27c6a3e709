"""A scanner as an image sees it: noise of a given spectrum added to textured regions, without a simulated scan."""
