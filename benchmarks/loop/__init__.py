"""Closing the loop: train, fly elsewhere, diagnose, train on what the diagnosis found, fly again, predict."""
