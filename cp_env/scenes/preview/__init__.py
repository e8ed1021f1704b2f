"""What a source of scenes holds: a film, statistics and tables."""
