"""Proofs that a motion holds at all times of a run: enclosures by Chebyshev models, and an interval Newton test."""
