"""Formulations turn a `MechanicalSystem` into a `Dae`: one file each."""
