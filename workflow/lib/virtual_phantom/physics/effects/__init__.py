"""Effects of the acquisition chain, one file each. The effects catalogue is generated from them."""
