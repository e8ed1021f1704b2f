"""Pictures of a frame: what was sensed, what is true, what the ego saw, who was malicious, who is suspected."""
