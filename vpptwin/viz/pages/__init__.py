"""Pages that are played and served, live flights among them."""
