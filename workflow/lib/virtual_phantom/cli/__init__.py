"""The command `virtual-phantom`."""
