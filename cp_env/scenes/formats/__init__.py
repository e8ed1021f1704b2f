"""File formats that scenes are read from."""
