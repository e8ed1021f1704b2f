"""Attacks that are learned: PPO, policies, their training and their evaluation."""
