"""Structural analysis of equations: signature method, derivative array, exact inversion, zero dynamics."""
