"""What a problem is made of: quantities, systems in any coordinates, scenes with their limits."""
