"""A world without a detector, in which verifications are right with a given probability."""
