"""Numerics independent of mechanics: compiled calls, square systems, machine code, ranks, expressions."""
