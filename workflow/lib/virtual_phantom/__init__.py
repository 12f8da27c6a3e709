"""Simulate CT acquisitions of a virtual phantom and measure how far radiomics features can be trusted."""

__version__ = "0.1.0"
