"""The colours that all pictures share."""
