"""Sessions with hidden effects: drawn, flown in the independent simulation, diagnosed, counted (hidden_effects.py)."""
