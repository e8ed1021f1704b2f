"""Attacks that are learned: PPO, policies, their training and their evaluation."""

from __future__ import annotations

from agents.learning.policy import Policy, load_policy, policy_names, save_policy

__all__ = ["Policy", "load_policy", "policy_names", "save_policy"]
