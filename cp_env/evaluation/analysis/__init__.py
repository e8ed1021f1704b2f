"""What the stored records say: summaries, worst cases, curves."""
