"""Fastest manoeuvres of cranes within limits: how long they take, beside the built-in laws.

`python -m benchmarks.planning` (`make planning`) writes docs/planning/results.csv.
"""
