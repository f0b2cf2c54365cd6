"""Data of a problem: quantities, systems in any coordinates, scenes with their limits."""
