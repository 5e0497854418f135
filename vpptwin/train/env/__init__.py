"""The environment: what is observed, rewarded, randomized, and where episodes start and end."""
