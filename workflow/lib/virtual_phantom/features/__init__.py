"""The 86 radiomics features: names, extraction, tables."""
