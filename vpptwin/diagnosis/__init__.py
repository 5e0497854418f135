"""Given flights and a twin: what the twin gets wrong, its cause, and the gain of an extended twin on unseen flights."""
