"""Perturbations of shared maps: the channel that bounds them, and the loss that attacks ascend."""
