"""fgloc."""
