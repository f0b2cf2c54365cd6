"""The failure atlas behind docs/stability: `make atlas`, or `python -m benchmarks.atlas`.

One file a row. A row shows a way in which servo-constraint integration fails as theory predicts, and beside it a route
of this library that does not fail.
"""
