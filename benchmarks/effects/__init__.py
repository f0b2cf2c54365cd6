"""What leaving out an effect costs: estimates beside simulations, and the picture of the model levels."""
