"""Statistics of hypotheses, on toy simulators whose answers are known."""
