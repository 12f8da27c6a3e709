"""A first configuration for a CT and the regions drawn on it: `virtual-phantom init`."""
