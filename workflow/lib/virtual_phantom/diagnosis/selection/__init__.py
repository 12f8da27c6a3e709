"""Select the effects that a recording needs."""
