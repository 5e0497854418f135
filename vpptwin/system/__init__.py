"""Files, processes, signals, errors: what has nothing to do with robots."""
