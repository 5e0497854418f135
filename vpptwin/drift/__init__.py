"""What changed from session to session: parameters of a twin fitted to each, and how they drift."""
