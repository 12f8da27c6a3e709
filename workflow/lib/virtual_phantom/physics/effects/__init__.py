"""The effects, one file each. The catalogue in the docs is made from them."""
