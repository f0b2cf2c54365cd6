"""What can be wrong though every equation holds: limits, angles, branches, inputs far from the exact ones."""
