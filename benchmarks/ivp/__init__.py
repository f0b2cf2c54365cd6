"""The index-3 problems of the test set for initial value problem solvers: references and work-precision."""

from pathlib import Path

REFERENCES = Path(__file__).parent / "references.json"
"""Values at the end of the problems, written by `benchmarks.ivp.references`."""
