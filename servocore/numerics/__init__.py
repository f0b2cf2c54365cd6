"""Numerics that know no mechanics: compiled calls, square systems, machine code, ranks, expressions."""
