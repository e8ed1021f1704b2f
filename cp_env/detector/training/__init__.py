"""Training and evaluation of our own detector."""
