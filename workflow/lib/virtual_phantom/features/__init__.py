"""The 86 radiomics features: names, extraction, tables."""

# In a block of 4 x 4 x 4 voxels, 8 have all of their 26 neighbors in the ROI. Textures of smaller ROIs depend mostly
# on the shape of the ROI.
MINIMUM_VOXELS = 64
# A symmetrical, normalized n x n co-occurrence matrix has n(n + 1)/2 - 1 degrees of freedom: 2 for two gray levels,
# which all 22 GLCM features then depend on, and 0 for one level.
MINIMUM_GREY_LEVELS = 3
