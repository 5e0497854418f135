"""Proving grounds: robots simulated by physics that vpptwin shares nothing with, to hide effects in.

`drone` flies the planar drone, `mechanisms` draws carts, pendula and arms; `quadrotor`, `servo_arm`, `torque_arm` and
`leg` are one robot each; `logs` writes logs. They import nothing of vpptwin and install alone, as the
distribution `simgap` (proving/pyproject.toml). `runner` draws sessions, diagnoses them and counts how often verdicts
are right. Tests, benchmarks and examples import them from here.
"""
