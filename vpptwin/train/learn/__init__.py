"""PPO: networks, collection, updates, checkpoints."""
