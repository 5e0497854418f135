"""An actuator from runs on a thrust stand, and parameters of a twin from its flights."""
