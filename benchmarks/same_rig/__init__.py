"""One rig, one flight controller, one task, in every simulator that `benchmarks/peers.py` compares."""
