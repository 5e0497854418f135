"""Trained policies flown and measured."""
