"""How an evaluation is played: one process, several, or a Ray cluster."""
