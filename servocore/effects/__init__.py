"""Which physical effects a scene needs: estimates and simulations of leaving them out."""
