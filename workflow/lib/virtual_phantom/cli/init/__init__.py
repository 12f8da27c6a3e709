"""The command `virtual-phantom init`: a first configuration for a CT and its segmented regions."""
