"""What a log says about a rig's state: measurements by degree of freedom, estimated states, replays of a log."""
