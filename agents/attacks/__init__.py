"""Scripted attacks: the search for a perturbation, what it aims at, and when it is sent."""
