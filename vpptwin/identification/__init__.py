"""Numbers from measurements: an actuator from thrust-stand runs, parameters of a twin from flights."""
