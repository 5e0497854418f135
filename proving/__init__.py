"""Proving grounds: robots simulated by physics that vpptwin shares nothing with, to hide effects in.

`drone` flies the planar drone, `mechanisms` draws carts, pendula and arms; `quadrotor`, `servo_arm`, `torque_arm` and
`leg` are one robot each, and `hidden` writes their logs. `runner` draws sessions, diagnoses them and counts how often
verdicts are right. Simulations import nothing of vpptwin but the writer of logs. Tests, benchmarks and examples import
them from here.
"""
