"""Proof on concealed effects: seals, the score of a blind test, and its page. Nothing of the diagnosis imports this."""
