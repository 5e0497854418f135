"""Bayesian model comparison for simulations: statistics that know nothing of robots, logs or reports.

A hypothesis is a set of effects whose parameters are free. What it leaves of the measurements is judged window by
window in a Gaussian linear model (Gelman et al., Bayesian Data Analysis, ch. 14), in which the state that a window
starts from, force pulses (process noise), and the scales of both noises are unknown too.
"""
