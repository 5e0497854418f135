"""What is drawn and plotted of the drone otherwise than of any rig: rotors, thrust, setpoints, effects in flight."""
