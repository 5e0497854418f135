"""What might explain it: suspects, how improbable a residual is, and fits of hypotheses in the twin."""
