"""What an evaluation plays, and what is stored of it."""
