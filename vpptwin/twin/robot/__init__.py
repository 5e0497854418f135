"""What a robot is: MJCF or URDF, joints, actuators, signals, and the effects that it may have."""
