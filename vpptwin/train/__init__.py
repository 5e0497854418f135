"""Training a policy in the twin: environment, tasks, networks, PPO, evaluation.

Only `config`, `tasks`, `reward`, `observe` and `randomize` can be imported without loading torch.
"""
